//! A controller of a line of probes, to be broken from outside.
//!
//! `probe-controller COUNT CHAT_MS AGENT [ARGS...]`: prints `ready` once every module has heard from
//! its neighbours, lets them chat if `CHAT_MS` is above 0, and goes on until it is asked to end. Then
//! it prints what the swarm came to, one `name=value` a line.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is how it talks to the test")]

use metamorph_protocol::time::Span;
use metamorph_tests::probe::{ProbeOrder, ProbeSetup, ProbeWorld};
use metamorph_tests::script::Script;
use metamorph_world_controller::swarm::{SwarmOptions, run_swarm};
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut args = std::env::args_os().skip(1);
    let mut number = || args.next()?.to_str()?.parse::<u32>().ok();
    let (Some(count), Some(chat)) = (number(), number()) else { return ExitCode::from(2) };
    let Some(agent) = args.next() else { return ExitCode::from(2) };
    let mut options = SwarmOptions::new(agent.into());
    options.program_args = args.collect();
    options.catch_signals = true;
    options.setup_timeout = std::time::Duration::from_secs(90);

    let mut script = Script::new(count).deadline(Span::secs(3_600));
    for i in 1..count {
        script = script.send(i - 1, 1, i, 1).send(i, 0, i, 1);
    }
    script = script
        .until("all messages", move |log| log.all_got() as u32 >= 2 * (count - 1))
        .world(|_| println!("ready"));
    if chat > 0 {
        for i in 0..count {
            script = script.order(i, ProbeOrder::Chat(Span::millis(chat.into())));
        }
    }
    let mut script = script.until("the end", |_| false);
    match run_swarm(&options, &ProbeSetup::default(), &mut ProbeWorld::line(count), &mut script) {
        Ok(o) => {
            let t = o.tally.total();
            println!("setup_ms={}", o.setup.as_millis());
            println!("alive={}", o.alive);
            println!("crashes={}", o.crashes.len());
            println!("external={}", o.external);
            println!("foreign={}", o.foreign);
            println!("interrupted={}", u8::from(o.interrupted));
            println!("missing_counters={}", o.missing_counters.len());
            println!("sent={}", t.sent);
            println!("delivered={}", t.delivered);
            println!("overflowed={}", t.overflowed);
            println!("in_flight={}", t.in_flight());
            println!("wakes={}", o.wakes);
            for crash in o.crashes {
                eprintln!("{crash:?}");
            }
            ExitCode::SUCCESS
        }
        Err(e) => {
            eprintln!("{e}");
            ExitCode::FAILURE
        }
    }
}
