"""Gaits in a second engine: plays gait files in MuJoCo, and compares the speeds with those that the files have.

    pip install mujoco numpy
    for s in $(seq 1 50); do
      metamorph learn quad5-sym --method random --trials 1 --seeds $s..$((s + 1)) --write random/$s.json
    done
    python deploy/python/examples/second_engine.py deploy/structures/quad5-sym.json random/*.json

Bodies, motors and the trial are those of docs/locomotion.md, made here anew from the kinematics of docs/roombots.md. Joint
angles are those of oscillators in lock; agents and messages are not simulated.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

CELL = 0.11  # metres
OUTER = 63.98 / 110.0  # radius of a hemisphere, in cells
MASS = 0.35  # of a hemisphere, kg
NO_LOAD = (2.785546, 2.031563, 2.785546)  # rad/s
TORQUE = (4.9, 3.6, 4.9)  # Nm
GAIN = 10.0  # speed command by error of the angle, 1/s
TICK = 0.01  # seconds between commands of the motors
STEP = 0.002  # of the engine
REST = 2.0  # seconds before the gait
FREQUENCY = 0.2  # of the oscillators, Hz
RATE = 2.0  # of amplitudes and offsets, 1/s
COLLISION = 0.002  # metres of overlap
FRICTION = {"thesis": (0.8,), "robust": (0.8, 0.6, 1.0)}

DIAGONAL = np.ones(3) / np.sqrt(3.0)
THIRD = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)  # a third of a turn about it
FLIP = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], float)
AXES = (DIAGONAL, np.array([0.0, 0.0, 1.0]), DIAGONAL)
PIVOTS = np.array([[0, 0, 0.5], [0, 0, 1.0], [0, 0, 1.5]])


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))


def pose(rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, origin
    return matrix


def motions(angles: list[float]) -> list[np.ndarray]:
    """Motions of hemispheres 0 to 3 of a module from the posture with all joints at 0; angles in radians."""
    found = [np.eye(4)]
    for axis, pivot, angle in zip(AXES, PIVOTS, angles):
        rotation = turn(axis, angle)
        found.append(found[-1] @ pose(rotation, pivot - rotation @ pivot))
    return found


def hemispheres(angles: list[float]) -> list[np.ndarray]:
    centres = (PIVOTS[0], PIVOTS[0], PIVOTS[2], PIVOTS[2])
    return [motion @ pose(np.eye(3), centre) for motion, centre in zip(motions(angles), centres)]


def connector(name: str, angles: list[float]) -> np.ndarray:
    """Frame of a connector such as C0X in that of its module: +z into the module."""
    hemisphere = int(name[1])
    turns = np.linalg.matrix_power(THIRD, "XYZ".index(name[2]))
    end = FLIP if hemisphere in (1, 3) else np.eye(3)
    frame = hemispheres(angles)[hemisphere] @ pose(turns @ end, np.zeros(3))
    frame[:3, 3] -= 0.5 * frame[:3, 2]
    return frame


def hull(upper: bool) -> np.ndarray:
    """The 40 points of a hemisphere about the centre of its cube, in metres."""
    points = []
    rim = np.sqrt(OUTER**2 - 0.25)
    for axis in range(3):
        for angle in np.arange(8) * np.pi / 4:
            point = np.zeros(3)
            point[axis], point[axis - 2], point[axis - 1] = 0.5, rim * np.cos(angle), rim * np.sin(angle)
            points.append(point)
    u, v = np.array([1, -1, 0]) / np.sqrt(2), np.array([1, 1, -2]) / np.sqrt(6)
    points += [OUTER * (u * np.cos(a) + v * np.sin(a)) for a in np.arange(12) * np.pi / 6]
    edge = OUTER / np.sqrt(2)
    points += [np.full(3, OUTER / np.sqrt(3)), *(edge * (1 - np.eye(3)))]
    return np.asarray((CELL if upper else -CELL) * np.array(points))


@dataclass
class Placed:
    """A structure in space, in metres on the floor."""

    connections: list[tuple[int, int]]  # hemispheres that are one body: 4 * module + hemisphere
    halves: list[np.ndarray]
    axes: list[tuple[np.ndarray, np.ndarray]]  # by joint: a point and the direction


def place(structure: dict[str, Any], down: str) -> Placed:
    modules = structure["modules"]
    degrees = structure.get("joints_deg") or [[0.0] * 3] * modules
    angles = [list(np.radians(q)) for q in degrees]
    poses = {0: np.eye(4)}
    while len(poses) < modules:
        for c in structure["connections"]:
            across = pose(FLIP @ turn(np.array([0.0, 0.0, 1.0]), np.pi / 2 * c.get("rotation", 0)), np.zeros(3))
            ends = [connector(c["at"], angles[c["a"]]), connector(c["to"], angles[c["b"]])]
            link = ends[0] @ across @ np.linalg.inv(ends[1])
            if c["a"] in poses and c["b"] not in poses:
                poses[c["b"]] = poses[c["a"]] @ link
            elif c["b"] in poses and c["a"] not in poses:
                poses[c["a"]] = poses[c["b"]] @ np.linalg.inv(link)
    axis = "xyz".index(down[1])
    up, east = np.zeros(3), np.zeros(3)
    up[axis], east[axis - 1] = (1.0 if down[0] == "-" else -1.0), 1.0
    upright = pose(np.array([east, np.cross(up, east), up]), np.zeros(3))
    scale = np.diag([CELL, CELL, CELL, 1.0])
    metres = scale @ upright
    halves, axes = [], []
    for module in range(modules):
        for half in hemispheres(angles[module]):
            found = metres @ poses[module] @ half
            halves.append(pose(found[:3, :3] / CELL, found[:3, 3]))
        for motion, direction, pivot in zip(motions(angles[module]), AXES, PIVOTS):
            found = metres @ poses[module] @ motion
            axes.append((found[:3, :3] @ direction / CELL, found @ np.append(pivot, 1.0)))
    lowest = min((h[:3, :3] @ p + h[:3, 3])[2] for i, h in enumerate(halves) for p in hull(i % 2 == 1))
    lift = np.array([0.0, 0.0, -lowest])
    for half in halves:
        half[:3, 3] += lift
    joined = [
        (4 * c["a"] + int(c["at"][1]), 4 * c["b"] + int(c["to"][1])) for c in structure["connections"]
    ]
    return Placed(joined, halves, [(point[:3] + lift, direction) for direction, point in axes])


def quaternion(rotation: np.ndarray) -> str:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, rotation.flatten())
    return " ".join(map(str, found))


def text(vector: np.ndarray) -> str:
    return " ".join(map(str, np.ravel(vector)))


def model(placed: Placed, friction: float) -> mujoco.MjModel:
    """All frames are that of the world at the start, so that axes and shapes need no others."""
    group = list(range(len(placed.halves)))
    for a, b in placed.connections:
        group = [group[a] if g == group[b] else g for g in group]
    seen = {group[0]}

    def body(root: int, inner: str) -> str:
        geoms = "".join(
            f'<geom name="g{i}" type="mesh" mesh="m{i % 2}" pos="{text(half[:3, 3])}" '
            f'quat="{quaternion(half[:3, :3])}" mass="{MASS}"/>'
            for i, half in enumerate(placed.halves)
            if group[i] == root
        )
        children = ""
        for joint, (point, axis) in enumerate(placed.axes):
            lower = 4 * (joint // 3) + joint % 3
            for here, there, sign in ((lower, lower + 1, 1), (lower + 1, lower, -1)):
                if group[here] == root and group[there] not in seen:
                    seen.add(group[there])
                    hinge = f'<joint name="j{joint}" pos="{text(point)}" axis="{text(sign * axis)}"/>'
                    children += body(group[there], hinge)
        return f"<body>{inner}{geoms}{children}</body>"

    bodies = body(group[0], "<freejoint/>")
    meshes = "".join(f'<mesh name="m{i}" vertex="{text(hull(i == 1))}"/>' for i in (0, 1))
    motors = "".join(
        f'<velocity joint="j{joint}" kv="50" forcerange="-{TORQUE[joint % 3]} {TORQUE[joint % 3]}"/>'
        for joint in range(len(placed.axes))
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="10"/>'
        f'<default><geom friction="{friction} 0 0" condim="3" solref="0.01 1"/></default>'
        f'<asset>{meshes}</asset><worldbody><geom name="floor" type="plane" size="0 0 1"/>{bodies}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )


@dataclass
class Outcome:
    speed: float  # mm/s
    collided: bool
    cost: float  # of transport: work of the motors by weight and distance


def trial(placed: Placed, gait: list[dict[str, float]], seconds: float, friction: float) -> Outcome:
    engine = model(placed, friction)
    data = mujoco.MjData(engine)
    joints = len(placed.axes)
    where = np.array([engine.joint(f"j{j}").qposadr[0] for j in range(joints)])
    rates = np.array([engine.joint(f"j{j}").dofadr[0] for j in range(joints)])
    no_load = np.array([NO_LOAD[j % 3] for j in range(joints)])
    amplitude, offset, phase = np.zeros(joints), np.zeros(joints), np.zeros(joints)
    for part in gait:
        j = int(part["joint"])
        amplitude[j], offset[j] = part["amplitude_rad"], part["offset_rad"]
        phase[j] = 2 * np.pi * part["phase_turns"]
    module = np.array([int(engine.geom(g).name[1:]) // 4 if g else -1 for g in range(engine.ngeom)])
    start, work, collided = None, 0.0, False
    for tick in range(round((REST + seconds) / TICK)):
        time = tick * TICK - REST
        target = np.zeros(joints)
        if time >= 0:
            grown = 1 - np.exp(-RATE * time)
            target = grown * (amplitude * np.sin(2 * np.pi * FREQUENCY * time + phase) + offset)
            start = data.subtree_com[0].copy() if start is None else start
        for _ in range(round(TICK / STEP)):
            data.ctrl[:] = np.clip(GAIN * (target - data.qpos[where]), -no_load, no_load)
            mujoco.mj_step(engine, data)
            if time >= 0:
                work += float(np.maximum(data.actuator_force * data.qvel[rates], 0).sum()) * STEP
        pairs = module[data.contact.geom]
        meet = (pairs.min(axis=1) >= 0) & (pairs[:, 0] != pairs[:, 1]) if len(pairs) else np.zeros(0, bool)
        if bool((meet & (data.contact.dist < -COLLISION)).any()):
            collided = True
            break
    distance = float(np.linalg.norm((data.subtree_com[0] - start)[:2])) if start is not None else 0.0
    weight = MASS * len(placed.halves) * 9.81
    speed = 1000 * distance / seconds * (0.001 if collided else 1.0)
    return Outcome(speed, collided, work / (weight * max(distance, 1e-9)))


def spearman(a: list[float], b: list[float]) -> float:
    first, second = (np.argsort(np.argsort(values)) - (len(values) - 1) / 2 for values in (a, b))
    return float((first * second).sum() / (first * first).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("structure", type=Path, help="a structure file with connections by connectors")
    parser.add_argument("gaits", type=Path, nargs="+", help="gait files of this structure, without dead modules")
    options = parser.parse_args()
    structure = json.loads(options.structure.read_text())
    here, there = [], []
    print("file                        engine of the file   MuJoCo  collided  cost of transport")
    for path in options.gaits:
        file = json.loads(path.read_text())
        study, best = file["study"], file["best"]
        placed = place(structure, study["down"])
        frictions = FRICTION[study["fitness"]]
        outcomes = [trial(placed, best["joints"], study["trial_s"], friction) for friction in frictions]
        worst = min(outcomes, key=lambda outcome: outcome.speed)
        here.append(best["fitness_mm_s"])
        there.append(worst.speed)
        met = "yes" if any(outcome.collided for outcome in outcomes) else "no"
        print(f"{path.name:27} {here[-1]:13.1f} mm/s {there[-1]:8.1f}  {met:8}  {outcomes[0].cost:.1f}")
    kept = sum(b >= 0.5 * a for a, b in zip(here, there))
    print(f"{kept} of {len(here)} gaits keep half of their speed")
    if len(here) > 2:
        print(f"Spearman's rank correlation {spearman(here, there):.2f}")


if __name__ == "__main__":
    main()
