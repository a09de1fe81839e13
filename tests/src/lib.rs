//! Shared parts of the tests across crates.
//!
//! [`probe`] is a family of modules that only sends what it is told and reports what it senses;
//! [`mod@conformance`] is the suite that every driver passes, written against it; [`chaos`] breaks swarms of
//! real processes from outside, [`daemons`] their hosts and cables; [`mod@hostile`] gives hostile inputs to commands; [`growth`] is the
//! experiment that tests of the cube protocol vary, [`metamodules`] the one of the thesis, whose variations
//! [`cases`] gives names; [`command`] is `metamorph` as a user runs it, [`view`] its page; [`checker`] reads journals without
//! code of the program and checks every position, [`journal_file`] says where they can be damaged; [`statistics`] compares samples; [`open_metrics`] reads the text of metrics;
//! [`required`] are checks that may be skipped, [`json_schema`] are those of documents.

pub mod browser;
pub mod cases;
pub mod chaos;
pub mod checked_run;
pub mod checker;
pub mod command;
pub mod conformance;
pub mod daemons;
pub mod growth;
pub mod hostile;
pub mod hosts;
pub mod journal_file;
pub mod json_schema;
pub mod metamodules;
pub mod network;
pub mod open_metrics;
pub mod page;
pub mod probe;
pub mod required;
pub mod script;
pub mod statistics;
pub mod studio;
pub mod testbed;
pub mod view;
