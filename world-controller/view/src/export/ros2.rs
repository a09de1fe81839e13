//! Messages of ROS 2 in CDR, the encoding of its middleware, as far as needed here: `visualization_msgs/MarkerArray`,
//! `sensor_msgs/PointCloud2`, `tf2_msgs/TFMessage`, `diagnostic_msgs/DiagnosticArray` and `rcl_interfaces/Log`, with their definitions for the
//! recording.

use super::foxglove::{Colour, Level};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Time;
use metamorph_scene::parts::Part;

/// A definition with those that it refers to, as recordings hold them.
pub struct Definition {
    /// The name of the type.
    pub name: &'static str,
    /// Its text.
    pub text: &'static str,
}

/// The definition of a point in time.
macro_rules! time {
    () => {
        "================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"
    };
}

/// The definitions of a header.
macro_rules! header {
    () => {
        concat!(
            "================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
",
            time!()
        )
    };
}

/// The definition of a vector.
macro_rules! vector {
    () => {
        "================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"
    };
}

/// The definition of a rotation.
macro_rules! quaternion {
    () => {
        "================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"
    };
}

/// The markers of all modules.
pub const MARKERS: Definition = Definition {
    name: "visualization_msgs/msg/MarkerArray",
    text: concat!(
        "visualization_msgs/Marker[] markers
================================================================================
MSG: visualization_msgs/Marker
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
",
        header!(),
        "================================================================================
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
",
        quaternion!(),
        vector!(),
        "================================================================================
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a
================================================================================
MSG: sensor_msgs/CompressedImage
std_msgs/Header header
string format
uint8[] data
================================================================================
MSG: visualization_msgs/UVCoordinate
float32 u
float32 v
================================================================================
MSG: visualization_msgs/MeshFile
string filename
uint8[] data
",
    ),
};

/// The frames of all modules.
pub const FRAMES: Definition = Definition {
    name: "tf2_msgs/msg/TFMessage",
    text: concat!(
        "geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
",
        header!(),
        vector!(),
        quaternion!(),
    ),
};

/// The centres of all modules.
pub const CLOUD: Definition = Definition {
    name: "sensor_msgs/msg/PointCloud2",
    text: concat!(
        "std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
",
        header!(),
        "================================================================================
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
",
    ),
};

/// A line of the log.
pub const LOG: Definition = Definition {
    name: "rcl_interfaces/msg/Log",
    text: concat!(
        "builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
",
        time!(),
    ),
};

/// The processes of modules.
pub const DIAGNOSTICS: Definition = Definition {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    text: concat!(
        "std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
",
        header!(),
        "================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
",
    ),
};

/// The frame that positions are in.
const WORLD: &str = "world";

/// A message that is being written: little endian, with every number aligned to its size.
struct Cdr(Vec<u8>);

impl Cdr {
    /// Length of the header, which does not count for alignment.
    const HEADER: usize = 4;

    fn new() -> Cdr {
        Cdr(vec![0, 1, 0, 0])
    }
    fn aligned<const N: usize>(&mut self, bytes: [u8; N]) -> &mut Cdr {
        while !(self.0.len() - Cdr::HEADER).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
        self
    }
    fn u8(&mut self, n: u8) -> &mut Cdr {
        self.aligned([n])
    }
    fn u32(&mut self, n: u32) -> &mut Cdr {
        self.aligned(n.to_le_bytes())
    }
    fn f32(&mut self, n: f32) -> &mut Cdr {
        self.aligned(n.to_le_bytes())
    }
    fn f64s<const N: usize>(&mut self, numbers: [f64; N]) -> &mut Cdr {
        for n in numbers {
            self.aligned(n.to_le_bytes());
        }
        self
    }
    fn text(&mut self, text: &str) -> &mut Cdr {
        // The length counts the zero at the end.
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
        self
    }
    fn stamp(&mut self, at: Time) -> &mut Cdr {
        const SECOND_NS: u64 = 1_000_000_000;
        self.u32((at.0 / SECOND_NS) as u32).u32((at.0 % SECOND_NS) as u32)
    }
    fn header(&mut self, at: Time, frame: &str) -> &mut Cdr {
        self.stamp(at).text(frame)
    }
    fn rotation(&mut self, part: &Part) -> &mut Cdr {
        self.f64s(part.pose.rotation.coords.into())
    }
}

/// A box of a module.
pub struct Marker {
    /// The name of the module.
    pub name: String,
    /// The number of the box in the module.
    pub number: u32,
    /// The part that it stands for.
    pub part: Part,
    /// Its edges in cells.
    pub size: [f64; 3],
    /// Its colour.
    pub colour: Colour,
}

/// Returns the markers of all modules, in cells of one metre.
pub fn markers(at: Time, markers: &[Marker]) -> Vec<u8> {
    /// Code of a cube among the types of `visualization_msgs/Marker`.
    const CUBE: u32 = 1;
    let mut cdr = Cdr::new();
    cdr.u32(markers.len() as u32);
    for Marker { name, number, part, size, colour } in markers {
        cdr.header(at, WORLD).text(name).u32(*number).u32(CUBE).u32(0);
        cdr.f64s(part.centre().into()).rotation(part).f64s(*size);
        for channel in colour.rgba() {
            cdr.f32(channel);
        }
        // Shown until replaced; no points, colours or texture.
        cdr.u32(0).u32(0).u8(0).u32(0).u32(0).text("").header(Time::ZERO, "").text("").u32(0).u32(0);
        // No text and no mesh.
        cdr.text("").text("").text("").u32(0).u8(0);
    }
    cdr.0
}

/// A module as a point.
pub struct CloudPoint {
    /// Its number.
    pub module: ModuleId,
    /// Its centre in cells of one metre.
    pub at: [f64; 3],
    /// Its colour.
    pub colour: Colour,
}

/// Returns the centres of all modules with their colours and numbers: fields `x`, `y`, `z`, `rgb` and `module`. Viewers without markers draw
/// these.
pub fn cloud(at: Time, points: &[CloudPoint]) -> Vec<u8> {
    /// Code of whole numbers of 32 bits among the types of `sensor_msgs/PointField`.
    const UINT32: u8 = 6;
    /// Code of floating-point numbers of 32 bits.
    const FLOAT32: u8 = 7;
    const FIELDS: [(&str, u8); 5] =
        [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), ("rgb", UINT32), ("module", UINT32)];
    /// Bytes of a field.
    const WIDTH: u32 = 4;
    const STEP: u32 = FIELDS.len() as u32 * WIDTH;
    let count = points.len() as u32;
    let mut cdr = Cdr::new();
    cdr.header(at, WORLD).u32(1).u32(count).u32(FIELDS.len() as u32);
    for (i, (name, kind)) in (0..).zip(FIELDS) {
        cdr.text(name).u32(i * WIDTH).u8(kind).u32(1);
    }
    cdr.u8(0).u32(STEP).u32(STEP * count).u32(STEP * count);
    for CloudPoint { module, at, colour } in points {
        at.iter().for_each(|x| cdr.0.extend((*x as f32).to_le_bytes()));
        let [r, g, b, _] = colour.rgba().map(|channel| (channel * 255.0).round() as u32);
        cdr.0.extend((r << 16 | g << 8 | b).to_le_bytes());
        cdr.0.extend(module.0.to_le_bytes());
    }
    cdr.u8(1);
    cdr.0
}

/// Returns the frames of modules, each that of its first part.
pub fn frames<'p>(at: Time, parts: impl ExactSizeIterator<Item = (String, &'p Part)>) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.u32(parts.len() as u32);
    for (name, part) in parts {
        cdr.header(at, WORLD).text(&name).f64s(part.centre().into()).rotation(part);
    }
    cdr.0
}

/// Returns what has become of the process of a module.
pub fn diagnostics(at: Time, id: ModuleId, level: Level, process: &str) -> Vec<u8> {
    let level = match level {
        Level::Info => 0,
        Level::Warning => 1,
        Level::Error => 2,
    };
    let name = format!("module_{id}");
    let mut cdr = Cdr::new();
    cdr.header(at, "").u32(1).u8(level).text(&name).text(process).text(&name).u32(0);
    cdr.0
}

/// Returns a line of the log.
pub fn log(at: Time, level: Level, message: &str) -> Vec<u8> {
    let level = match level {
        Level::Info => 20,
        Level::Warning => 30,
        Level::Error => 40,
    };
    let mut cdr = Cdr::new();
    cdr.stamp(at).u8(level).text("metamorph").text(message).text("").text("").u32(0);
    cdr.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers are aligned from behind the header, and texts end with a zero.
    #[test]
    fn numbers_are_aligned() {
        let mut cdr = Cdr::new();
        cdr.u8(7).u32(1).u8(2).f64s([1.0]).text("a");
        let expected: [&[u8]; 7] = [
            &[0, 1, 0, 0],
            &[7, 0, 0, 0, 1, 0, 0, 0],
            &[2, 0, 0, 0, 0, 0, 0, 0],
            &1.0f64.to_le_bytes(),
            &[2, 0, 0, 0],
            b"a",
            &[0],
        ];
        assert_eq!(cdr.0, expected.concat());
    }
}
