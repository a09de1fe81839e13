//! A sweep as an array of SLURM jobs, on a SLURM that is started on this machine: jobs are requeued, and the joined files are
//! those of one machine.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::chaos::wait_until;
use metamorph_tests::command::{metamorph, root, run};
use metamorph_tests::required::{Check, is_required, skip};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The sweep of the test.
const SWEEP: [&str; 5] = ["swarm", "--seeds", "0..400", "--vary", "link.loss=0%,5%"];
/// Number of its parts.
const PARTS: usize = 4;

/// A SLURM of three nodes, ended when dropped.
struct Lab(PathBuf);

impl Lab {
    fn start(directory: &Path) -> Lab {
        let lab = Lab(directory.join("lab"));
        lab.call("start");
        lab
    }

    fn call(&self, action: &str) {
        let output =
            Command::new(root().join("deploy/cluster/lab-slurm")).arg(action).arg(&self.0).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }

    /// Runs a command of SLURM in a directory, and returns what it prints.
    fn slurm(&self, directory: &Path, words: &[&str]) -> String {
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).current_dir(directory).env("SLURM_CONF", self.0.join("slurm.conf"));
        let output = command.env("METAMORPH", metamorph()).output().unwrap();
        assert!(output.status.success(), "{words:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        let _ = Command::new(root().join("deploy/cluster/lab-slurm")).arg("stop").arg(&self.0).output();
    }
}

#[test]
fn jobs_of_slurm_that_are_requeued_give_the_files_of_one_machine() {
    if !is_required(Check::Slurm) {
        return skip(Check::Slurm, "a SLURM on this machine is started only where it is required");
    }
    let directory = tempfile::tempdir().unwrap();
    let lab = Lab::start(directory.path());
    let place = directory.path();
    fs::create_dir(place.join("parts")).unwrap();
    let script = root().join("deploy/cluster/array.sbatch").display().to_string();
    let array = format!("--array=1-{PARTS}");
    let job = lab.slurm(place, &[&["sbatch", "--parsable", &array, &script], &SWEEP[..]].concat());
    let job = job.trim();
    let runs =
        |part: usize| fs::metadata(place.join(format!("parts/{part}/runs.csv"))).map_or(0, |m| m.len());
    for part in [1, 2] {
        wait_until("a part to have runs", || runs(part) > 2_000);
        lab.slurm(place, &["scontrol", "requeue", &format!("{job}_{part}")]);
    }
    wait_until("all jobs to end", || {
        lab.slurm(place, &["squeue", "-h", "-r", "-t", "all", "-o", "%t"]).lines().all(|state| state == "CD")
    });
    let parts: Vec<String> =
        (1..=PARTS).map(|i| place.join(format!("parts/{i}")).display().to_string()).collect();
    let [joined, whole] = ["joined", "whole"].map(|name| place.join(name).display().to_string());
    let join: Vec<&str> = ["sweep", "--join"]
        .into_iter()
        .chain(parts.iter().map(String::as_str))
        .chain(["--out", &joined])
        .collect();
    let ran = run(&join);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let ran = run(&[&["sweep"], &SWEEP[..], &["--out", &whole, "--quiet"]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for file in ["runs.csv", "manifest.json", "summary.json", "report.html"] {
        let read = |directory: &str| fs::read(Path::new(directory).join(file)).unwrap();
        assert!(read(&joined) == read(&whole), "{file}");
    }
}
