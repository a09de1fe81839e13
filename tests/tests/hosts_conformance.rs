//! The conformance suite on real processes of two hosts, connected by Unix sockets.

use metamorph_tests::testbed::HostsBed;

metamorph_tests::conformance!(HostsBed::new(env!("CARGO_BIN_EXE_probe-agent")));
