//! The standstills in the course of a run, and the help that resolved them, in the report.

use crate::prospect::Prospect;
use crate::run_result::RunResult;
use crate::schema::{Standstill, StandstillEvent, StandstillsReport};
use metamorph_core::time::Time;
use metamorph_kernel::director::standstills::{StandstillEnd, StandstillRecord, Standstills};
use metamorph_scenario::Plan;
use metamorph_text::format::{count, many};

/// Says which help a built run had, as the end of a sentence.
pub fn help(ran: &RunResult) -> String {
    let ends = ran.standstills.counts();
    let of = |counts: &dyn Fn(StandstillEnd) -> bool| -> u64 {
        StandstillEnd::ALL.into_iter().zip(ends).filter(|(end, _)| counts(*end)).map(|(_, n)| n).sum()
    };
    let (all, rescued) = (of(&|_| true), of(&|end| end.is_rescue()));
    let standstills = many(all, "standstill");
    let mut text = match rescued {
        0 if ran.bodies.led > 0 => ", by plans of the controller".to_owned(),
        0 => String::new(),
        _ if rescued == all => format!(", after {standstills} that the controller resolved"),
        _ => format!(", after {standstills}, of which the controller resolved {}", count(rescued)),
    };
    if let Some(operator) = ran.operator.as_ref().filter(|operator| operator.commands > 0) {
        text += &format!(", with {} of an operator", many(operator.commands, "command"));
    }
    text
}

/// Returns the standstills of a run for its report.
pub fn report(plan: &Plan, standstills: &Standstills) -> StandstillsReport {
    let ends = || StandstillEnd::ALL.into_iter().zip(standstills.counts());
    StandstillsReport {
        rescue: if plan.swarm.has_rescue() { plan.rescue.name() } else { "none" }.to_owned(),
        count: ends().map(|(_, n)| n).sum(),
        rescued: ends().filter(|(end, _)| end.is_rescue()).map(|(_, n)| n).sum(),
        ended: ends().map(|(end, n)| (end.name().to_owned(), n)).collect(),
        events: standstills.kept().iter().map(standstill_event).collect(),
    }
}

fn standstill_event(record: &StandstillRecord) -> StandstillEvent {
    let Standstill { since_s, reason, text, unfilled, open, wait_cycle, waiting, .. } =
        super::standstill(&record.stall, &Prospect::UNDECIDED);
    StandstillEvent {
        since_s,
        noticed_s: record.noticed.as_secs_f64(),
        until_s: record.until.map(Time::as_secs_f64),
        ended_by: record.end.name().to_owned(),
        moving: record.is_jam,
        reason,
        text,
        unfilled,
        open,
        wait_cycle,
        waiting,
        called: record.help.called,
        led: record.help.led,
    }
}
