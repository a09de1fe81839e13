//! Messages in the schemas `foxglove.SceneUpdate` and `foxglove.Log`, as far as needed here; the schemas are
//! derived from these types. Not here: primitives other than cubes, whose lists are always empty, but expected
//! by readers.

use metamorph_protocol::time::Time;
use metamorph_scene::parts::Part;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;

/// Returns the JSON schema of a type, without references, which some readers do not follow.
pub fn schema_of<T: JsonSchema>() -> Vec<u8> {
    let settings = SchemaSettings::draft07().with(|settings| settings.inline_subschemas = true);
    let schema = settings.into_generator().into_root_schema_for::<T>();
    serde_json::to_vec(&schema).expect("invariant: a schema is plain JSON")
}

/// A point in time.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "time")]
pub struct Stamp {
    sec: u64,
    nsec: u32,
}

impl From<Time> for Stamp {
    fn from(at: Time) -> Stamp {
        const SECOND_NS: u64 = 1_000_000_000;
        Stamp { sec: at.0 / SECOND_NS, nsec: (at.0 % SECOND_NS) as u32 }
    }
}

/// A duration; zero means until replaced.
#[derive(Clone, Copy, Debug, Default, Serialize, JsonSchema)]
#[schemars(title = "duration")]
struct Lifetime {
    sec: i64,
    nsec: u32,
}

#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.Vector3")]
struct Vector {
    x: f32,
    y: f32,
    z: f32,
}

#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.Quaternion")]
struct Quaternion {
    x: f32,
    y: f32,
    z: f32,
    w: f32,
}

#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.Pose")]
struct Pose {
    position: Vector,
    orientation: Quaternion,
}

/// Red, green, blue and opacity, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(title = "foxglove.Color")]
pub struct Colour {
    r: f32,
    g: f32,
    b: f32,
    a: f32,
}

impl Colour {
    /// Returns red, green, blue and opacity.
    pub fn rgba(self) -> [f32; 4] {
        [self.r, self.g, self.b, self.a]
    }
    /// Returns the colour for red, green and blue of 0 to 255.
    pub const fn rgb(r: u8, g: u8, b: u8) -> Colour {
        Colour { r: r as f32 / 255.0, g: g as f32 / 255.0, b: b as f32 / 255.0, a: 1.0 }
    }
}

/// A cube.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.CubePrimitive")]
pub struct Cube {
    pose: Pose,
    size: Vector,
    color: Colour,
}

impl Cube {
    /// Returns a box about the centre of a part.
    pub fn new(part: &Part, size: [f64; 3], color: Colour) -> Cube {
        let vector = |[x, y, z]: [f64; 3]| Vector { x: x as f32, y: y as f32, z: z as f32 };
        let [x, y, z, w] = part.pose.rotation.coords.map(|q| q as f32).into();
        let pose = Pose { position: vector(part.centre().into()), orientation: Quaternion { x, y, z, w } };
        Cube { pose, size: vector(size), color }
    }
}

/// A property that is shown of a selected entity.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.KeyValuePair")]
pub struct Pair<'a> {
    /// Its name.
    pub key: &'static str,
    /// Its value.
    pub value: &'a str,
}

/// A primitive that is never written.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct Never {}

/// One entity of the scene.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.SceneEntity")]
pub struct Entity<'a> {
    timestamp: Stamp,
    frame_id: &'static str,
    id: String,
    lifetime: Lifetime,
    frame_locked: bool,
    metadata: [Pair<'a>; 2],
    arrows: &'static [Never],
    cubes: Vec<Cube>,
    spheres: &'static [Never],
    cylinders: &'static [Never],
    lines: &'static [Never],
    triangles: &'static [Never],
    texts: &'static [Never],
    models: &'static [Never],
}

impl<'a> Entity<'a> {
    /// Returns an entity of cubes.
    pub fn new(at: Time, id: String, metadata: [Pair<'a>; 2], cubes: Vec<Cube>) -> Entity<'a> {
        Entity {
            timestamp: at.into(),
            frame_id: "world",
            id,
            lifetime: Lifetime::default(),
            frame_locked: false,
            metadata,
            arrows: &[],
            cubes,
            spheres: &[],
            cylinders: &[],
            lines: &[],
            triangles: &[],
            texts: &[],
            models: &[],
        }
    }
}

/// Entities that are new or have changed.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.SceneUpdate")]
pub struct SceneUpdate<'a> {
    deletions: &'static [Never],
    entities: Vec<Entity<'a>>,
}

impl<'a> SceneUpdate<'a> {
    /// Returns an update that replaces entities with the same names; others stay.
    pub fn new(entities: Vec<Entity<'a>>) -> SceneUpdate<'a> {
        SceneUpdate { deletions: &[], entities }
    }
}

/// The level of a line of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// For information.
    Info = 2,
    /// Deserves attention.
    Warning = 3,
    /// An error.
    Error = 4,
}

/// A line of the log.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(title = "foxglove.Log")]
pub struct Log<'a> {
    timestamp: Stamp,
    level: u8,
    message: &'a str,
    name: &'static str,
    file: &'static str,
    line: u32,
}

impl<'a> Log<'a> {
    /// Returns a line of the log.
    pub fn new(at: Time, level: Level, message: &'a str) -> Log<'a> {
        Log { timestamp: at.into(), level: level as u8, message, name: "metamorph", file: "", line: 0 }
    }
}
