//! Reads shapes and configurations: by name, or from structure files.

use super::connected;
use super::document::{Module, PLAN, PlanFile, Posed, STRUCTURE, Structure, StructureFile, VERSION};
use super::error::PlanError;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::named;
use metamorph_protocol::assembly::shape::Shape;
use metamorph_protocol::assembly::structure::{self, Placed, StructureError};
use metamorph_protocol::assembly::tables::Vec3;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::posture::Posture;
use metamorph_text::escape::Shown;
use metamorph_text::sources::Sources;
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::path::Path;

/// The largest file that is read, in bytes.
const LARGEST: u64 = 16 << 20;

/// A shape, with joint values or without.
#[derive(Clone, Debug)]
pub enum Structured {
    /// Without.
    Shape(Shape),
    /// With.
    Configuration(Configuration),
}

impl Structured {
    /// Returns the shape.
    pub fn shape(&self) -> Shape {
        match self {
            Structured::Shape(shape) => *shape,
            Structured::Configuration(configuration) => Shape::of(configuration),
        }
    }
}

/// Reads a shape by its name, or a file.
pub fn structured(sources: &dyn Sources, option: &str, text: &str) -> Result<Structured, PlanError> {
    match named::shape(text) {
        Ok(shape) => Ok(Structured::Shape(shape)),
        Err(named::NameError::Unknown(_)) if text.contains(['.', '/']) || sources.exists(Path::new(text)) => {
            read_structure(sources, option, Path::new(text))
        }
        Err(error) => Err(PlanError::Name { place: format!("{option} {}", text.shown()), error }),
    }
}

fn read_structure(sources: &dyn Sources, option: &str, path: &Path) -> Result<Structured, PlanError> {
    let place = format!("{option} {}", path.shown());
    match read_structure_file(sources, &place, path)? {
        StructureFile::Cells(document) => of_document(&place, &document),
        StructureFile::Connected(document) => connected::structured(&place, &document),
    }
}

/// The key that only one of the two forms of structure files has.
#[derive(Deserialize)]
struct Form {
    connections: Option<IgnoredAny>,
}

/// Reads a structure file of either form.
pub fn read_structure_file(
    sources: &dyn Sources,
    place: &str,
    path: &Path,
) -> Result<StructureFile, PlanError> {
    let text = read_text(sources, place, path, "structure")?;
    let form: Form = parse(place, &text, "structure")?;
    let file = match form.connections {
        None => StructureFile::Cells(parse(place, &text, "structure")?),
        Some(_) => StructureFile::Connected(parse(place, &text, "structure")?),
    };
    let (format, version) = match &file {
        StructureFile::Cells(s) => (&s.format, s.version),
        StructureFile::Connected(s) => (&s.format, s.version),
    };
    if (format.as_str(), version) != (STRUCTURE, VERSION) {
        return Err(other_version(place.to_owned(), STRUCTURE, format, version, "structure"));
    }
    Ok(file)
}

/// Reads a plan.
pub fn read_plan(sources: &dyn Sources, option: &str, path: &Path) -> Result<PlanFile, PlanError> {
    let place = format!("{option} {}", path.shown());
    read_document(sources, &place, path, (PLAN, VERSION), "plan")
}

fn other_version(place: String, wanted: &str, format: &str, version: u32, schema: &'static str) -> PlanError {
    let reason = format!("this is `{}` version {version}, not `{wanted}` version {VERSION}", format.shown());
    PlanError::Format { place, reason, schema }
}

fn read_text(
    sources: &dyn Sources,
    place: &str,
    path: &Path,
    schema: &'static str,
) -> Result<Vec<u8>, PlanError> {
    sources.read(path, LARGEST).map_err(|error| PlanError::Read { place: place.to_owned(), error, schema })
}

fn parse<T: DeserializeOwned>(place: &str, text: &[u8], schema: &'static str) -> Result<T, PlanError> {
    let wrong = |place: String, reason: String| PlanError::Format { place, reason, schema };
    serde_json::from_slice(text).map_err(|error| {
        let at = format!("{place}, line {}, column {}", error.line(), error.column());
        let text = error.to_string();
        let reason = text.split(" at line ").next().unwrap_or(&text).shown();
        wrong(at, reason)
    })
}

/// Header of every document: the name of its format and the version.
#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
}

/// Reads a JSON document of a format and version; `schema` is the name of its schema.
pub fn read_document<T: DeserializeOwned>(
    sources: &dyn Sources,
    place: &str,
    path: &Path,
    (format, version): (&str, u32),
    schema: &'static str,
) -> Result<T, PlanError> {
    let text = read_text(sources, place, path, schema)?;
    let head: Head = parse(place, &text, schema)?;
    if (head.format.as_str(), head.version) != (format, version) {
        return Err(other_version(place.to_owned(), format, &head.format, head.version, schema));
    }
    parse(place, &text, schema)
}

/// Interprets a structure.
pub fn of_document(place: &str, document: &Structure) -> Result<Structured, PlanError> {
    if (document.format.as_str(), document.version) != (STRUCTURE, VERSION) {
        let (format, version) = (&document.format, document.version);
        return Err(other_version(place.to_owned(), STRUCTURE, format, version, "structure"));
    }
    let wrong = |error| PlanError::Structure { place: place.to_owned(), error };
    let format = |reason: String| PlanError::Format { place: place.to_owned(), reason, schema: "structure" };
    let given = document.modules.iter().map(|m| match m {
        Module::Cells(cells) | Module::Posed(Posed { cells, .. }) => *cells,
    });
    let given: Vec<[[i64; 3]; 2]> = given.collect();
    if given.len() > metamorph_protocol::assembly::configuration::MAX_MODULES {
        return Err(wrong(StructureError::TooMany(given.len())));
    }
    let all: Vec<[i64; 3]> = given.iter().chain(&document.joined).flatten().copied().collect();
    let near = structure::around_first(&all).ok_or_else(|| {
        format("cells are farther apart than the modules of a connected structure can be".to_owned())
    });
    let near = if all.is_empty() { Vec::new() } else { near? };
    let pairs: Vec<[Vec3; 2]> = near.chunks_exact(2).map(|c| [c[0], c[1]]).collect();
    let (cells, joined) = pairs.split_at(given.len());
    let posed = document.modules.iter().filter(|m| matches!(m, Module::Posed(_))).count();
    if posed == 0 {
        return structure::joined(cells, joined).map(Structured::Shape).map_err(wrong);
    }
    if posed < cells.len() {
        return Err(format("some modules have poses and others have none".to_owned()));
    }
    let mut placed = Vec::new();
    for (i, (module, cells)) in document.modules.iter().zip(cells).enumerate() {
        let Module::Posed(posed) = module else { continue };
        // Larger numbers cannot be distinguished from multiples of a step.
        if let Some(degrees) = posed.joints_deg.iter().find(|d| !(-360.0..=360.0).contains(*d)) {
            return Err(format(format!("module {i}: a joint at {degrees}° is not within ±360°")));
        }
        let posture = Posture::from_degrees(Kind::Single, &posed.joints_deg, 1e-6)
            .map_err(|error| format(format!("module {i}: {error}")))?;
        let steps = posture.steps().try_into().expect("invariant: a module has three joints");
        placed.push(Placed { cells: *cells, rotation: posed.foot_rotation, steps });
    }
    structure::configured(&placed, joined).map(Structured::Configuration).map_err(wrong)
}

/// Describes a shape.
pub fn shape_document(shape: &Shape) -> Structure {
    let wide = |cells: [Vec3; 2]| cells.map(|c| c.map(i64::from));
    Structure {
        format: STRUCTURE.to_owned(),
        version: VERSION,
        modules: shape.bars().iter().map(|bar| Module::Cells(wide(bar.cells()))).collect(),
        joined: structure::joined_cells(shape).into_iter().map(wide).collect(),
    }
}

/// Describes a configuration, with module 0 at the origin.
pub fn configuration_document(configuration: &Configuration) -> Structure {
    let wide = |cells: [Vec3; 2]| cells.map(|c| c.map(i64::from));
    let origin = configuration.modules()[0].cell;
    let shape = shape_document(&Shape::of(configuration));
    let back = |cell: [i64; 3]| [0, 1, 2].map(|i| cell[i] - i64::from(origin[i]));
    let posed = |p: &Placed| {
        let posture = Posture::from_steps(Kind::Single, &p.steps).expect("invariant: three joints");
        let degrees: Vec<f64> = posture.degrees().into_iter().map(f64::from).collect();
        Module::Posed(Posed {
            cells: wide(p.cells),
            foot_rotation: p.rotation,
            joints_deg: [degrees[0], degrees[1], degrees[2]],
        })
    };
    Structure {
        modules: structure::placed(configuration).iter().map(posed).collect(),
        joined: shape.joined.iter().map(|pair| pair.map(back)).collect(),
        ..shape
    }
}
