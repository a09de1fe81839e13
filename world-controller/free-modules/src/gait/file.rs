//! Reads gait files.

use super::document::{FORMAT, GaitFile, VERSION, read as gait};
use super::space::Gait;
use crate::plan::PlanError;
use crate::plan::input::read_document;
use metamorph_text::sources::Sources;
use std::path::Path;

/// Reads a gait file; `place` names it in messages.
///
/// # Errors
/// Refuses what is no gait file of this version.
pub fn read(sources: &dyn Sources, place: &str, path: &Path) -> Result<GaitFile, PlanError> {
    read_document(sources, place, path, (FORMAT, VERSION), "gait")
}

/// Returns the best gait of a file, of the structure with this fingerprint and number of modules.
///
/// # Errors
/// Refuses a file of another structure, one without gaits, and wrong parameters.
pub fn best(place: &str, file: &GaitFile, fingerprint: &str, modules: usize) -> Result<Gait, PlanError> {
    let theirs = &file.study.fingerprint;
    if theirs != fingerprint {
        let reason = format!("the gait is of a structure with fingerprint {theirs}, not {fingerprint}");
        return Err(PlanError::option(place, reason, "name a gait of this structure"));
    }
    let best = file.best.as_ref().ok_or_else(|| {
        PlanError::option(place, "there is no gait in it", "let the study try gaits first, with --resume")
    })?;
    gait(&best.joints, 3 * modules).map_err(|(joint, what)| {
        let reason = format!("joint {joint} {what}");
        PlanError::option(place, reason, "learn the gait again, or correct the file")
    })
}
