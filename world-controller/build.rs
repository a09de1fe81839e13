//! Links the program at a fixed address where that saves memory.
//!
//! Every agent is a process of this program. A program that can be loaded at any address has its tables of pointers adjusted at
//! each start, and each process then keeps its own copy of them: half of all that an agent takes (`metamorph bench swarm`). At a
//! fixed address they are pages of the file, which all processes share.

use std::env;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let target = |key| env::var(key).unwrap_or_default();
    // The C library decides which start files are linked; others are left as they are.
    if target("CARGO_CFG_TARGET_OS") == "linux" && target("CARGO_CFG_TARGET_ENV") == "gnu" {
        println!("cargo:rustc-link-arg-bins=-no-pie");
    }
}
