"""Sweeps 200 runs into a table, plots them, and repeats a run with a fault that was injected."""

import matplotlib.pyplot as plt
import metamorph as mm

SCENARIO = "swarm"
runs = mm.sweep(SCENARIO, seeds=range(100), vary={"link.loss": ["0%", "5%"]}).to_pandas()  # 200 runs
assert (runs.outcome == "built").all()
print(runs.groupby("link.loss")[["moves", "makespan_s"]].median())
runs.boxplot(column="makespan_s", by="link.loss")
plt.savefig("makespan.svg")

sim = mm.Simulation(SCENARIO, seed=1)
sim.advance("2s")
sim.inject("kill 7")
sim.run()
assert mm.run(sim.scenario(), seed=1).trace_hash == sim.trace_hash
