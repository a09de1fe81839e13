"""Proves that the protocols are safe for any number of parties, and that the models are neither empty nor
blind.

For each part: all obligations (`inductive.py`), which of its actions are possible at all, and with
`--defects` how each known defect of the protocol is refused. Ends with 0 if everything is proved, every
action is possible and every defect is refused.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pathlib
import sys
import time

import floor_locks
import floor_runs
import forest
import forest_runs
import host_link
import inductive
import lease_runs
import leases

PARTS = [
    dataclasses.replace(leases.PART, runs=lease_runs.RUNS),
    dataclasses.replace(forest.PART, runs=forest_runs.RUNS, complete_run=forest_runs.every_action),
    dataclasses.replace(floor_locks.PART, runs=floor_runs.RUNS),
    host_link.PART,
]


def check(part: inductive.Part, with_defects: bool, smt: pathlib.Path | None) -> dict:
    """Checks a part. Returns the findings."""
    begun = time.perf_counter()
    results = inductive.prove(part.build(), smt)
    proved_in = time.perf_counter() - begun
    begun = time.perf_counter()
    findings = {
        "part": part.name,
        "title": part.title,
        "obligations": len(results),
        "proved": sum(result.is_proved for result in results),
        "open": [[r.action, r.invariant, r.answer] for r in results if not r.is_proved],
        "millis": round(proved_in * 1000),
        "impossible": part.impossible(),
        "refused": [],
        "not_refused": [],
    }
    for defect in part.refusals if with_defects else []:
        refusal = part.refuse(defect)
        if refusal is None:
            findings["not_refused"].append(defect)
            continue
        found = {"found": part.found[defect]} if defect in part.found else {}
        findings["refused"].append(dataclasses.asdict(refusal) | found)
    findings["other_millis"] = round((time.perf_counter() - begun) * 1000)
    return findings


def tell(findings: dict, part: inductive.Part, is_verbose: bool):
    """Prints the findings of a part."""
    counts = f"{findings['proved']} of {findings['obligations']} proved in {findings['millis']} ms"
    print(f"{findings['title']}: {counts}; the rest took {findings['other_millis']} ms")
    for action, invariant, answer in findings["open"]:
        print(f'  open: "{invariant}" after {action} ({answer})')
    for what in findings["impossible"]:
        print(f"  not shown to be possible: {what}")
    for refusal in findings["refused"]:
        print(f'  {refusal["defect"]}: {refusal["by"]}, "{refusal["invariant"]}"')
        if "found" in refusal:
            print(f"    found by the proof: {refusal['found']}")
        if is_verbose:
            print("    " + refusal["text"].replace("\n", "\n    "))
    for defect in findings["not_refused"]:
        print(f"  NOT REFUSED: {defect}")
    sys.stdout.flush()


def main() -> int:
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser(
        description="Proves that the protocols are safe for any number of parties."
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(names)}; all by default")
    parser.add_argument("--defects", action="store_true", help="show how each known defect is refused")
    parser.add_argument("--verbose", action="store_true", help="print counterexamples and runs")
    parser.add_argument(
        "--smt", metavar="DIR", type=pathlib.Path, help="write each obligation as SMT-LIB text"
    )
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    options = parser.parse_args()
    unknown = [name for name in options.parts if name not in names]
    if unknown:
        parser.error(f"no such part: {', '.join(unknown)}")
    if options.smt:
        options.smt.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    all_findings = []
    for part in PARTS:
        if options.parts and part.name not in options.parts:
            continue
        findings = check(part, options.defects, options.smt)
        all_findings.append(findings)
        if not options.json:
            tell(findings, part, options.verbose)
    totals = {
        "obligations": sum(f["obligations"] for f in all_findings),
        "proved": sum(f["proved"] for f in all_findings),
        "refused": sum(len(f["refused"]) for f in all_findings),
        "not_refused": sum(len(f["not_refused"]) for f in all_findings),
        "impossible": sum(len(f["impossible"]) for f in all_findings),
        "millis": round((time.perf_counter() - begun) * 1000),
    }
    is_fine = (
        totals["proved"] == totals["obligations"] and not totals["not_refused"] and not totals["impossible"]
    )
    if options.json:
        print(json.dumps({"parts": all_findings, "totals": totals, "is_fine": is_fine}, indent=2))
    else:
        refused = totals["refused"], totals["refused"] + totals["not_refused"]
        defects = f", {refused[0]} of {refused[1]} defects refused" if options.defects else ""
        counts = f"{totals['proved']} of {totals['obligations']} obligations proved{defects}"
        print(f"{counts}, {totals['millis'] / 1000:.1f} s")
    return 0 if is_fine else 1


if __name__ == "__main__":
    sys.exit(main())
