"""A node that is restarted in mid-run: how often the relay turns for nothing.

The figures of docs/explanation/theory.md: `./koop test src/koop_loop/test/test_joining.py -s`.
"""

import numpy as np
import pytest

from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_loop.kernel import LoopMemory
from koop_loop.loop import controller
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig, shipped_model
from koopman_lifter.model import load
from relay_esc import relay
from relay_esc.config import EscConfig
from relay_esc.relay import RelayState
from relay_esc.swing import OPEN
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

NOBODY, LIFTER, CONTROLLER = 0, 1, 2
SILENT = 600  # steps, 3 s, that the node is away
SEEDS = 200
WATCHED = 9000  # steps, 45 s, once theta moves again


@njit()
def run(plant, p, memory, work, x, y, who, at, joins, theta):
    """Restart a node at a step; it joins the run, or behaves as if the run began with it."""
    source, lifting, detector_params, relay_params = p
    detector, relay_state = memory
    state = np.empty(2)
    applied = relay_state.output
    for k in range(theta.shape[0]):
        away = who != NOBODY and at <= k < at + SILENT
        back = who != NOBODY and k == at + SILENT
        state[0], state[1] = dynamics.measure(plant, k, x, y)
        first = Arrival.RESTART if k == 0 else Arrival.NEXT
        begin = Arrival.JOIN if joins else Arrival.RESTART
        if not away:
            to_lifter = begin if back and who == LIFTER else first
            to_controller = first
            if back:
                to_controller = Arrival.RESUME if who == LIFTER else begin
                if who == CONTROLLER:  # with theta as it was: it is the filter that is looked at
                    relay_state = RelayState(
                        relay_state.u, 1, 0.0, 0.0, 0, False, relay_state.commanded,
                        relay_state.output, OPEN,
                    )  # fmt: skip
            r, _, settling, detector = cost.answer(
                source, lifting, detector_params, detector, to_lifter, k, state, work
            )
            relay_state, _, _ = relay.answer(
                relay_params, relay_state, to_controller, False, settling, r, False
            )
        elif who == CONTROLLER:  # the lifter goes on
            _, _, _, detector = cost.answer(
                source, lifting, detector_params, detector, first, k, state, work
            )
        theta[k] = relay_state.output
        x, y, applied = dynamics.advance(plant, k, x, y, applied, theta[k])


def turned_for_nothing(who, joins):
    """Return of how many seeds theta turns away from an optimum that is far, in per cent."""
    model, lifter, esc = load(shipped_model()), LifterConfig(), EscConfig()
    p, wait = controller(lifter, esc, model), 0
    if joins and who == LIFTER:
        wait = p.detector.settling
    elif joins and who == CONTROLLER:
        wait = p.relay.settling
    wrong = counted = 0
    for seed in range(SEEDS):
        phases = np.random.default_rng([seed, 0]).uniform(0.0, 2.0 * np.pi, 2)
        plant = PlantConfig(
            seed=seed, interference_phase_1=phases[0], interference_phase_2=phases[1]
        ).params()
        at = round(np.random.default_rng([seed, 9]).uniform(20.0, 50.0) / 0.005)
        theta = np.empty(at + SILENT + wait + WATCHED)
        memory = LoopMemory(cost.initial(), esc.initial())
        work = cost.workspace(p.lifting)
        run(plant, p, memory, work, *dynamics.initial_state(seed), who, at, joins, theta)
        if not (theta[at - 1] < theta[at - 20] and theta[at] > -1.0):
            continue  # it was on a wrong way before
        counted += 1
        moves = np.diff(theta[at - 20 :])
        before = theta[at - 20 : -1][moves != 0.0]
        direction = np.sign(moves[moves != 0.0])
        away = (direction[1:] > 0.0) & (direction[:-1] < 0.0) & (before[1:] > -2.4)
        wrong += bool(away.any())
    return 100.0 * wrong / counted


@pytest.fixture(scope="module")
def undisturbed():
    share = turned_for_nothing(NOBODY, False)
    print(f"\nnobody restarted: {share:.0f} %")
    return share


@pytest.mark.parametrize(
    ("who", "name", "most"), [(LIFTER, "lifter", 1.0), (CONTROLLER, "controller", 3.0)]
)
def test_a_node_that_joins_a_run_turns_the_relay_for_nothing_less_often(
    who, name, most, undisturbed
):
    """The lifter: no more than if nobody is restarted. The controller lost its filter for good."""
    begins, joins = turned_for_nothing(who, False), turned_for_nothing(who, True)
    print(f"{name} restarted: {begins:.0f} % if its filters begin at 0, {joins:.0f} % if it joins")
    assert joins < begins / 2.0
    assert joins <= most * undisturbed
