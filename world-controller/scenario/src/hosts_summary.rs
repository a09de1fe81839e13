//! The description of the hosts of a plan, for `metamorph check`.

use super::Plan;
use metamorph_core::ids::HostId;
use metamorph_core::link::{Between, Burst, End, Hosts, LinkModel, Lost};
use metamorph_core::time::Time;
use metamorph_text::format::{listed, many, whole_percent};
use std::fmt::{Result, Write};

/// Largest number of hosts listed, and of links that differ.
const SHOWN_MAX: usize = 12;

/// Describes the hosts.
pub fn write(out: &mut String, plan: &Plan, hosts: &Hosts) -> Result {
    let modules = plan.swarm.len();
    // Invariant: there are fewer than 2^16 hosts.
    let all = || (0..hosts.len() as u16).map(HostId);
    let mut list: Vec<String> = Vec::new();
    for host in all() {
        let modules: Vec<u32> = hosts.modules(host).map(|id| id.0).collect();
        // Invariant: each host has at least one module.
        let (first, last) = (modules[0], modules[modules.len() - 1]);
        let is_block = (last - first) as usize + 1 == modules.len();
        list.push(match is_block {
            true => format!("{host} modules {first} to {last}"),
            false => format!("{host} {} between {first} and {last}", many(modules.len() as u64, "module")),
        });
    }
    writeln!(out, "  hosts     {}{}", list[..list.len().min(SHOWN_MAX)].join(", "), dots(list.len()))?;
    if let Some(contacts) = plan.swarm.contacts() {
        let crossing = contacts.iter().filter(|(a, b)| hosts.home(*a) != hosts.home(*b)).count() as u64;
        let total = contacts.len() as u64;
        let share = whole_percent(crossing, total);
        writeln!(out, "            {crossing} of {} at the start cross ({share})", many(total, "contact"))?;
    }
    if modules > 0 && hosts.len() > 1 {
        write_links(out, hosts)?;
    }
    let clocks: Vec<String> = all().filter_map(|host| clock(hosts, host)).collect();
    if !clocks.is_empty() {
        writeln!(
            out,
            "            clocks: {}{}",
            clocks[..clocks.len().min(SHOWN_MAX)].join(", "),
            dots(clocks.len())
        )?;
    }
    if let Lost::Elsewhere { fence } = hosts.lost() {
        writeln!(
            out,
            "            modules of a lost host start elsewhere, after {fence} where it is simulated"
        )?;
    }
    for ((a, b), link) in hosts.links() {
        for cut in &link.partitions {
            writeln!(
                out,
                "            {a} and {b} cut off from each other from {} to {}",
                cut.from, cut.until
            )?;
        }
    }
    Ok(())
}

fn dots(len: usize) -> &'static str {
    if len > SHOWN_MAX { ", …" } else { "" }
}

fn clock(hosts: &Hosts, host: HostId) -> Option<String> {
    let offset = hosts.clock(host).0;
    let side = if offset > 0 { "ahead" } else { "behind" };
    let by = metamorph_core::time::Span(offset.unsigned_abs());
    (offset != 0).then(|| format!("{host} {by} {side}"))
}

/// Describes the links: one line if all are alike.
fn write_links(out: &mut String, hosts: &Hosts) -> Result {
    let described: Vec<_> = hosts.links().map(|(pair, link)| (pair, rates(link))).collect();
    let usual = &described[0].1;
    if described.iter().all(|(_, text)| text == usual) {
        return writeln!(out, "            between them {usual}");
    }
    for ((a, b), text) in described.iter().take(SHOWN_MAX) {
        writeln!(out, "            between {a} and {b} {text}")?;
    }
    match described.len().saturating_sub(SHOWN_MAX) {
        0 => Ok(()),
        more => writeln!(out, "            … and {}", many(more as u64, "link")),
    }
}

/// Describes a link of its own.
pub fn between(between: &Between) -> String {
    let Between { ends, one_way, from, until, link } = between;
    let named = |end: &End| {
        let ids: Vec<u32> = end.0.iter().map(|id| id.0).collect();
        if ids.is_empty() { "any".to_owned() } else { listed(&ids, SHOWN_MAX) }
    };
    let [a, b] = ends.each_ref().map(named);
    let way = if *one_way { format!("from {a} to {b}") } else { format!("between {a} and {b}") };
    let time = match (*from, *until) {
        (Time::ZERO, Time::NEVER) => String::new(),
        (from, Time::NEVER) => format!(" from {from} on"),
        (from, until) => format!(" from {from} to {until}"),
    };
    format!("{way}{time}: {}", rates(link))
}

/// Describes the delay of a link and what it does to messages.
pub fn rates(link: &LinkModel) -> String {
    let mut out = match (link.delay_min, link.delay_max) {
        (min, max) if max.0 == 0 && min.0 == 0 => "no added delay".to_owned(),
        (min, max) if min == max => format!("delay {min}"),
        (min, max) if link.quantiles.is_some() => format!("delay {min} to {max}, by quantiles"),
        (min, max) => format!("delay {min} to {max}"),
    };
    let rates = [
        ("loss", link.loss),
        ("duplication", link.duplicate),
        ("reorder", link.reorder),
        ("corruption", link.corrupt),
    ];
    for (name, rate) in rates.iter().filter(|(_, rate)| !rate.is_zero()) {
        out.push_str(&format!("; {name} {rate}"));
    }
    if let Some(burst) = &link.burst {
        let Burst { enter, leave, loss, delay } = &**burst;
        let delay = delay.map_or_else(String::new, |(min, max)| format!(", delay {min} to {max}"));
        out.push_str(&format!(
            "; bursts: {enter} of messages begin one, {leave} end it; loss {loss}{delay} within"
        ));
    }
    out
}
