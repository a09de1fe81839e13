//! The conformance suite on real processes over shared memory.

use metamorph_tests::testbed::ProcessBed;

metamorph_tests::conformance!(ProcessBed::new(env!("CARGO_BIN_EXE_probe-agent")));
