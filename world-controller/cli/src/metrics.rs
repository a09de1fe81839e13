//! The option `--metrics` of commands that run for a while.

use clap::Args;
use metamorph_console::terminal::print_error;
use metamorph_processes::metrics::Metrics;
use metamorph_view::metrics_server::{MetricsAddress, MetricsError, serve_metrics};

/// The option.
#[derive(Clone, Debug, Args)]
pub struct MetricsArg {
    /// Serve metrics as OpenMetrics text while this command runs, at http://ADDRESS/metrics: a port such as 9100 or :9100 is one
    /// of this machine only, another address is said in full (10.0.0.2:9100); port 0 is a free one. Default: none
    #[arg(long, value_name = "ADDRESS")]
    pub metrics: Option<MetricsAddress>,
}

impl MetricsArg {
    /// Begins to serve metrics if they are asked for, and says where they are, unless `is_quiet`.
    ///
    /// # Errors
    /// If the address cannot be used.
    pub fn serve(&self, is_quiet: bool) -> Result<Option<Metrics>, MetricsError> {
        let Some(address) = &self.metrics else { return Ok(None) };
        let metrics = Metrics::default();
        let at = serve_metrics(metrics.clone(), address)?;
        if !is_quiet {
            print_error(&format!("metrics at {at}"));
        }
        Ok(Some(metrics))
    }
}
