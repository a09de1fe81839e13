//! The formats of the program with their versions.

use metamorph_module_agent::{journal_file, run_dir};
use metamorph_protocol::{host_link, roombots, wire};
use metamorph_world_controller::{
    cli, experiments, gait, plan, pointing, report, room, scenario, structure, studio, swarm, view,
};

/// A format.
#[derive(Clone, Copy, Debug)]
pub struct Format {
    /// Kind of content: `binary`, `text`, `json` or `page`.
    pub kind: &'static str,
    /// Its name in documents.
    pub name: &'static str,
    /// The version that this program reads and writes.
    pub version: u64,
}

/// Returns all formats. Plans and structures share one constant.
pub fn all() -> Vec<Format> {
    let format = |kind, name, version| Format { kind, name, version };
    let binary = |name, version| format("binary", name, version);
    let text = |name, version| format("text", name, version);
    let json = |name, version: u32| format("json", name, version.into());
    let page = |name, version| format("page", name, version);
    vec![
        binary("wire", wire::VERSION.into()),
        binary("host link", host_link::packet::VERSION.into()),
        binary("motion database", roombots::database::VERSION.into()),
        binary("journal", journal_file::VERSION.into()),
        binary("swarm file", run_dir::swarm_file::VERSION.into()),
        binary("counter file", run_dir::counter_file::VERSION.into()),
        text("scenario", scenario::error::VERSION),
        text("drawing", scenario::mesh_import::drawing::VERSION.into()),
        text("hosts file", swarm::HOSTS_FILE_VERSION),
        text("room", room::document::VERSION),
        text("session log", room::study_format::VERSION.into()),
        text("gait", gait::document::VERSION.into()),
        text("plan and structure", plan::document::VERSION.into()),
        text("sweep directory", experiments::sweep::store::VERSION.into()),
        text("trials of reproduce", experiments::reproduce::planners::trials::VERSION.into()),
        json("report", report::schema::SCHEMA),
        json("sweep summary", experiments::sweep::summary::SCHEMA),
        json("explore", experiments::explore::summary::SCHEMA),
        json("diff", experiments::diff::SCHEMA),
        json("why", experiments::why::answer::SCHEMA),
        json("reproduce", experiments::reproduce::compare::SCHEMA),
        json("reproduce of planners", experiments::reproduce::planners::SCHEMA),
        json("bench", experiments::BENCH_SCHEMA),
        json("structure", structure::SCHEMA),
        json("shape --modules", cli::PAIRING_SCHEMA),
        json("room", room::SCHEMA),
        json("point", pointing::SCHEMA),
        page("requests of the page of a run", view::control::VERSION.into()),
        page("requests of the studio", studio::VERSION.into()),
        page("scene of the page of a run", view::beginning::VERSION.into()),
    ]
}

/// Returns the formats of a kind, each with its version, or `None` if there are none.
pub fn list(kind: &str) -> Option<String> {
    let of_kind = all().into_iter().filter(|format| format.kind == kind);
    let named: Vec<String> = of_kind.map(|format| format!("{} {}", format.name, format.version)).collect();
    (!named.is_empty()).then(|| named.join(", "))
}

/// Returns the version of the first format of this name.
pub fn version(name: &str) -> Option<u64> {
    all().into_iter().find(|format| format.name == name).map(|format| format.version)
}
