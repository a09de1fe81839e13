//! Swarms divided among hosts, for experiments of all families.

use metamorph_protocol::ids::HostId;
use metamorph_protocol::link::{ClockOffset, Hosts, LinkModel};
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use std::sync::Arc;

/// Divides modules in equal blocks among hosts with these clocks. Links between hosts are as within them.
pub fn divide(link: &mut LinkModel, modules: usize, clocks: &[ClockOffset]) {
    let homes = (0..modules).map(|i| HostId((i * clocks.len() / modules) as u16)).collect();
    let links = Hosts::pairs(clocks.len()).map(|_| link.clone()).collect();
    let hosts = Hosts::new(homes, clocks.to_vec(), links).expect("invariant: the parts fit together");
    link.hosts = Some(Arc::new(hosts));
}

/// Cuts every pair of hosts again and again until `end`, for up to `longest` and with breaks of up to five seconds.
pub fn cut_again_and_again(link: &mut LinkModel, seed: u64, end: Time, longest: Span) {
    let mut hosts = Hosts::clone(link.hosts.as_ref().expect("invariant: there are hosts"));
    let mut rng = Rng::named(seed, "host-cuts", 0);
    let pause = |rng: &mut Rng| Span(rng.below(5_000_000_000));
    for (a, b) in Hosts::pairs(hosts.len()) {
        let mut from = Time::ZERO + pause(&mut rng);
        while from < end {
            let until = from + Span(1 + rng.below(longest.0));
            hosts.cut(a, b, from, until);
            from = until + pause(&mut rng);
        }
    }
    link.hosts = Some(Arc::new(hosts));
}
