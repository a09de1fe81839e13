//! The conformance suite on the simulator.

use metamorph_tests::testbed::SimBed;

metamorph_tests::conformance!(SimBed);
