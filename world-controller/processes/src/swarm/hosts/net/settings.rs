//! The settings of a zenoh session: mutual TLS, no discovery, and who may put and hear what, by the name in the
//! certificate. Everything that is not allowed here is refused by both ends.

use super::keys::Keys;
use crate::swarm::hosts::address::Address;
use metamorph_protocol::host_link::Timing;
use metamorph_protocol::ids::HostId;
use metamorph_scenario::hosts::MAX_HOSTS;
use serde_json::{Value, json};

/// Largest message that a session takes, in bytes; a packet is at most 60,000 bytes long.
const MAX_MESSAGE: usize = 131_072;
/// Largest number of connections in the middle of a handshake.
const PENDING_MAX: u32 = 16;
/// Number of sessions besides one with each host.
const SPARE_SESSIONS: usize = 8;

/// Returns the key on which a host puts packets for another in a run; `service` may be `*`.
pub fn key(run: &str, from: &str, to: &str, service: &str) -> String {
    format!("mm/{run}/{from}/{to}/{service}")
}

/// Returns the key of the liveliness token of a host, or of all (`*`).
pub fn alive(host: &str) -> String {
    format!("mm/alive/{host}")
}

/// Returns the endpoint of zenoh for an address, which only TLS reaches.
pub fn endpoint(address: &Address) -> Option<String> {
    match address {
        Address::Unix(_) => None,
        Address::Net { .. } => Some(format!("tls/{address}")),
    }
}

/// Returns the configuration of a session that listens on some addresses and connects to others.
pub fn settings(keys: &Keys, listen: &[String], connect: &[String]) -> Value {
    let file = |path: &std::path::Path| path.display().to_string();
    let silent = Timing::default().silent;
    json!({
        "mode": "peer",
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "connect": {
            "endpoints": connect,
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 },
        },
        "listen": { "endpoints": listen, "exit_on_failure": true },
        "adminspace": { "enabled": false },
        "timestamping": { "enabled": false },
        "transport": {
            "unicast": {
                "accept_pending": PENDING_MAX,
                "max_sessions": MAX_HOSTS + SPARE_SESSIONS,
            },
            "link": {
                "protocols": ["tls"],
                "tx": { "lease": silent.0 / 1_000_000, "keep_alive": 4 },
                "rx": { "max_message_size": MAX_MESSAGE },
                "tls": {
                    "root_ca_certificate": file(&keys.authority),
                    "listen_certificate": file(&keys.certificate),
                    "listen_private_key": file(&keys.key),
                    "connect_certificate": file(&keys.certificate),
                    "connect_private_key": file(&keys.key),
                    "enable_mtls": true,
                    "verify_name_on_connect": true,
                    "close_link_on_expiration": true,
                },
            },
        },
        "access_control": access(keys.host),
    })
}

/// Returns the rules by which a host takes packets: each other may put what comes from it and is for this host, hear what
/// is for it, and say that it is alive.
fn access(own: HostId) -> Value {
    let own = own.to_string();
    // Invariant: there are at most 256 hosts.
    let others: Vec<String> = (0..MAX_HOSTS as u16).map(|i| HostId(i).to_string()).collect();
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for other in &others {
        let rule = |id: &str, flow: &str, messages: &[&str], keys: &[String]| {
            json!({
                "id": format!("{other} {id}"), "permission": "allow", "flows": [flow],
                "messages": messages, "key_exprs": keys,
            })
        };
        let to_us = key("*", other, &own, "*");
        let to_them = key("*", &own, other, "*");
        let (ours, theirs) = (key("*", "*", &own, "*"), key("*", "*", other, "*"));
        let tokens = ["liveliness_token", "declare_liveliness_subscriber", "liveliness_query"];
        rules.extend([
            rule("puts", "ingress", &["put"], &[to_us]),
            rule("hears", "ingress", &["declare_subscriber"], &[theirs]),
            rule("lives", "ingress", &tokens[..1], &[alive(other)]),
            rule("asks", "ingress", &tokens[1..], &[alive("*")]),
            rule("is sent", "egress", &["put"], &[to_them]),
            rule("is asked", "egress", &["declare_subscriber"], &[ours]),
            rule("is told", "egress", &tokens, &[alive(&own), alive("*")]),
        ]);
        subjects.push(json!({ "id": other, "cert_common_names": [other] }));
        let ids = ["puts", "hears", "lives", "asks", "is sent", "is asked", "is told"];
        let ids: Vec<String> = ids.iter().map(|id| format!("{other} {id}")).collect();
        policies.push(json!({ "rules": ids, "subjects": [other] }));
    }
    json!({
        "enabled": true, "default_permission": "deny",
        "rules": rules, "subjects": subjects, "policies": policies,
    })
}
