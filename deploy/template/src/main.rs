//! The program: `sim` and `processes` run the protocol; `agent` is one module, and is started by the latter.

mod election;
mod leader;
mod run;

use leader::Leader;
use metamorph_module_agent::AgentArgs;
use metamorph_protocol::ratio::Ratio;
use run::{Outcome, processes, simulate};
use std::error::Error;
use std::process::ExitCode;

const USAGE: &str = "usage: sim|processes [SIDE] [LOSS], for example: sim 30 5%";

fn main() -> ExitCode {
    match answer() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn answer() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args_os().skip(1);
    let verb = args.next().unwrap_or_default();
    if verb == "agent" {
        return Ok(metamorph_module_agent::run::<Leader>(&AgentArgs::parse(args)?)?);
    }
    let mut text = || args.next().map(|word| word.to_string_lossy().into_owned());
    let side = text().map_or(Ok(5), |side| side.parse())?;
    let loss = text().map_or(Ok(Ratio::ZERO), |loss| loss.parse())?;
    if !(1..=100).contains(&side) {
        return Err(USAGE.into());
    }
    let Outcome { leader, sent, trace } = match verb.to_str() {
        Some("sim") => simulate(side, loss, 1),
        Some("processes") => processes(std::env::current_exe()?, side, loss)?,
        _ => return Err(USAGE.into()),
    };
    let (leader, at) = leader.ok_or("the modules did not agree within a minute")?;
    println!("all agreed on module {leader} after {at}, with {sent} messages");
    if let Some(trace) = trace {
        println!("trace {trace:016x}");
    }
    Ok(())
}
