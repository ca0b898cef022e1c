"""Rigs of the random family, excited offline, and their loop closed."""

import numpy as np

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_identify.recording.loaded import Loaded
from koop_study.commissioning import excitation
from koop_study.family.config import FamilyConfig
from koop_study.family.loop import RigController, close, from_end, noise_of
from koop_study.family.rig import draw
from koop_tune.rig.scale import Scale
from koop_tune.search.run import make_esc, make_lifter

CALM = {"drift": (0.0, 0.0), "frequency": (1.0, 1.0), "log_scaled": 0.0, "maximised": 0.0}
RATE = 0.5  # ranges of theta in the rig's own time, at most


def rig_of(seed=0, **family):
    """Draw a rig; ranges of a family as keywords."""
    return draw(FamilyConfig(**{**CALM, **family}), seed)


def file_of(rig):
    """Return its rig file."""
    return excitation.file_of(rig, RATE, 1e5)


def excited(rig, seed=0, stay=8.0, windows=24):
    """Return theta and x of a staircase up and down, then at random."""
    p = rig.params
    values = Scale(p.theta_min, p.theta_max).theta(np.linspace(0.0, 1.0, 9)).tolist()
    order = [*range(9), *range(7, -1, -1), *np.random.default_rng(seed).permutation(len(values))]
    rest = max(round(stay * rig.time / p.dt), windows * round(4 / rig.frequency / p.dt))
    parts, now = [], values[0]
    for level in order:
        way = abs(values[level] - now) / (p.theta_max - p.theta_min) * rig.time / RATE
        parts += [np.linspace(now, values[level], 2 + round(way / p.dt))[1:]]
        parts += [np.full(rest, values[level])]
        now = values[level]
    theta = np.concatenate(parts)
    return theta, rig.record(theta, seed)[0]


def loaded_of(theta, x):
    """Return the recording as it is loaded from a bag."""
    begins = np.arange(theta.size) == 0
    return Loaded(np.ascontiguousarray(x.T), begins, theta, np.arange(theta.size) * 1.0)


ANSWER = np.dtype(  # what is wanted of a koop_msgs/ControlInput
    {
        "names": ["encoding", "sec", "nanosec", "frame_id", "step", "count", "data"],
        "formats": ["<u4", "<i4", "<u4", "<u4", "<u8", "<u4", "<f8"],
        "offsets": [0, 4, 8, 12, 20, 28, 36],
        "itemsize": 100,
    }
)
KNOB = np.dtype([("encoding", "<u4"), ("data", "<f8")])


def write_bag(folder, rig, theta, x, loop=False):
    """Write a bag of koop_msgs/MeasuredState on /state, and theta.

    Of a loop that is koop_msgs/ControlInput on /theta, else std_msgs/Float64 on /knob.
    """
    state = np.dtype(
        {
            "names": ["encoding", "sec", "nanosec", "frame_id", "step", "count", "x"],
            "formats": ["<u4", "<i4", "<u4", "<u4", "<u8", "<u4", ("<f8", x.shape[1])],
            "offsets": [0, 4, 8, 12, 20, 32, 36],
            "itemsize": 36 + 8 * x.shape[1],
        }
    )
    states = np.zeros(theta.size, state)
    steps = np.arange(theta.size)
    stamps = 1_000_000_000 + np.round(steps * rig.params.dt * 1e9).astype(np.int64)
    states["encoding"], states["frame_id"], states["count"] = 0x0100, 1, x.shape[1]
    states["sec"], states["nanosec"] = np.divmod(stamps, 1_000_000_000)
    states["step"], states["x"] = steps, x
    knobs = np.zeros(theta.size, ANSWER if loop else KNOB)
    knobs["encoding"], knobs["data"] = 0x0100, theta
    if loop:
        knobs["count"] = 1
        for name in ("sec", "nanosec", "frame_id", "step"):
            knobs[name] = states[name]
    topic, kind = "/knob", "std_msgs/msg/Float64"
    if loop:
        topic, kind = "/theta", "koop_msgs/msg/ControlInput"
    with BagWriter(folder, WriterOptions(compression="none")) as bag:
        one = bag.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        other = bag.add_topic(topic, load_schema(kind))
        for at, given, measured in zip(stamps.tolist(), knobs, states, strict=True):
            bag.write_many([(at, other, at, given.tobytes()), (at, one, at, measured.tobytes())])
    return folder


def damped(rig, found, seed, end):
    """Close the tuned loop on the rig itself, from an end of the range.

    Returns the amplitude of the second half over that at the best theta (its inverse where it is to
    be large).
    """
    task, constants = found.task, found.best.constants
    esc = make_esc(task, constants, rig.theta_initial)
    controller = RigController(make_lifter(task, constants), esc, found.chosen.maps.cost.model)
    noise = noise_of(rig, task.steps, seed)
    return close(from_end(rig, end), controller, noise, seed).ratio
