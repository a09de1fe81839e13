//! The command `bench`.

use clap::Args;
use metamorph_bench::{Name, Request, bench};
use metamorph_console::command::{CommandOf, Group};
use std::path::PathBuf;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph bench                      everything; takes several minutes
  metamorph bench flood wire           the simulated and the process link, message by message
  metamorph bench growth --most 2500   sizes of up to 2,500 modules
  metamorph bench --quiet --json new.json && jq .flood new.json

What each measures:
  flood   a million simulated modules propagate hop counts from a corner: processor time and memory
  growth  a slab of 100 to 10,000 simulated modules becomes a ball: time, moves, messages,
          how freely modules walk, and how these grow
  pyramid a pyramid is built from a plate below it, solid and with tunnels: the same numbers
  chairs  the thesis's chair with every strategy, on all processors: runs per second
  gait    structures of 4 to 10 modules walk: how fast they are simulated, messages, learners
  wire    round trips and throughput of 64 bytes between two processes, beside bare iceoryx2, a Unix
          socket, a pipe and TCP
  swarm   100 to 5,000 processes: starting, exchanging, memory, idling
  churn   1,000 processes, of which 2 and then 20 per second are killed and restarted

Other load increases the times measured in real time (`wire` and `swarm`); compare numbers of one run.

Exit codes:
  0  everything was measured that this machine permits
  1  something could not be measured
  2  the command line is wrong";

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What to measure; default: everything
    #[arg(value_enum, value_name = "NAME")]
    pub names: Vec<Name>,
    /// Skip swarms of more than N modules; default: no limit
    #[arg(long, value_name = "N")]
    pub most: Option<u64>,
    /// Run `growth` and `pyramid` with this seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Write the numbers to this file
    #[arg(long, value_name = "FILE", default_value = "bench.json")]
    pub json: PathBuf,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<BenchArgs> for Request {
    fn from(args: BenchArgs) -> Request {
        Request { names: args.names, most: args.most, seed: args.seed, json: args.json, quiet: args.quiet }
    }
}

/// The command.
pub static COMMAND: CommandOf<BenchArgs> = CommandOf {
    name: "bench",
    group: Some(Group::Machine),
    about: "Measure both links beside bare mechanisms, in tables and as JSON",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(bench(&args.into())?),
};
