//! Figures of the run that a page shows, drawn as `render` draws them, while the run may be in progress.

use crate::request::{Kind, Origin, Request, Source, file};
use metamorph_scene::bodies::ShownSwarm;
use metamorph_scene::figure::FigureError;
use metamorph_scene::figure::options::Moment;
use metamorph_scene::shared::Shared;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// Data of a run that its figures need besides the scene: the bodies, and the origin.
#[derive(Clone)]
pub struct Subject {
    swarm: Arc<Mutex<Box<dyn ShownSwarm + Send>>>,
    origin: Arc<Origin>,
}

impl fmt::Debug for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.origin.fmt(f)
    }
}

/// A figure to be saved.
#[derive(Debug)]
pub struct Saved {
    /// The content of its file.
    pub data: Vec<u8>,
    /// The type of its content.
    pub content_type: &'static str,
    /// The name of its file.
    pub name: String,
}

impl Subject {
    /// Creates the subject of figures of a run.
    pub fn new(swarm: Box<dyn ShownSwarm + Send>, origin: Origin) -> Subject {
        Subject { swarm: Arc::new(Mutex::new(swarm)), origin: Arc::new(origin) }
    }

    /// Draws the figure that a page asks for, with the options as a query. `going` is asked before each frame whether
    /// to continue. Figures are drawn one after the other.
    ///
    /// # Errors
    ///
    /// What is wrong with the request, for the page.
    pub fn draw(
        &self,
        scene: &Shared,
        kind: Kind,
        query: &str,
        going: &dyn Fn() -> bool,
    ) -> Result<Saved, String> {
        let request = Request::of_query(query)?;
        let swarm = self.swarm.lock().unwrap_or_else(PoisonError::into_inner);
        // A copy, so that the run continues meanwhile.
        let scene = scene.lock().clone();
        if !scene.is_over() && matches!(request.at, Moment::Share(_)) {
            return Err(format!("--at {}: the run is not over\n  fix: name a time", request.at));
        }
        let source =
            Source { scene: &scene, swarm: &**swarm, origin: &self.origin, trace: scene.trace_hash() };
        let drawn = file(&source, &request, kind, going).map_err(|error: FigureError| error.to_string())?;
        let at = source.time(request.at).map_err(|error| error.to_string())?;
        let name = self.origin.title.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' });
        let (end, content_type) = kind.names();
        let name = format!("{}-{}s.{end}", name.collect::<String>(), at.as_secs_f64());
        Ok(Saved { data: drawn.data, content_type, name })
    }
}
