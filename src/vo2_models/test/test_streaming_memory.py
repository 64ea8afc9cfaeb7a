"""A memory with unseen stretches: the bound covers any excursion, and an end of the major loop makes it known again."""

import numpy as np
import pytest
from vo2_models.device import truth
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.self_sensing import self_sensing
from vo2_models.self_sensing.memory import StreamingMemory
from vo2_models.workflow import fit

RANGE = (11.19e3, 231.75e3)


@pytest.fixture(scope="module")
def device():
    return truth("integrated", seed=1, domains=1500)


@pytest.fixture(scope="module")
def schemes(device):
    share = damped_oscillation(np.linspace(0.0, 1.0, 21))
    recording = device.simulate(np.repeat(3.68e-3 + 4.81e-3 * share, 10), seed=1)
    model = fit(recording, "integrated")
    return {kind: self_sensing(kind, model) for kind in ("composite", "egpi", "preisach", "polynomial")}


def run(memory, resistances):
    return np.array([memory.step(float(resistance)) for resistance in resistances])


@pytest.mark.parametrize("kind", ["composite", "egpi", "preisach", "polynomial"])
def test_without_gaps_it_is_the_scheme_alone_once_the_past_is_erased(kind, device, schemes):
    currents = np.repeat([3.68e-3, 8.49e-3, 5e-3, 7e-3, 6e-3], 10)
    resistance = np.asarray(device.simulate(currents, seed=2)["film_resistance"])
    memory = StreamingMemory(schemes[kind], RANGE)
    found = run(memory, resistance)
    alone, _ = schemes[kind].estimate(resistance)
    np.testing.assert_array_equal(found[:, 0], np.asarray(alone.deflection))
    assert memory.known
    np.testing.assert_array_equal(found[20:, 2], np.asarray(alone.bound)[20:])


@pytest.mark.parametrize("seed", range(6))
def test_what_nobody_saw_is_within_the_bound_until_the_loop_closes(seed, device, schemes):
    """The device goes anywhere between two samples; what knows of all of it is the truth here."""
    rng = np.random.default_rng(seed)
    before = np.repeat([3.68e-3, 8.49e-3, 3.68e-3, 6.2e-3, 5.6e-3, 6.0e-3], 20)
    hidden = np.repeat(rng.uniform(3.68e-3, 8.49e-3, 4), 5)
    after = np.repeat(rng.uniform(5.6e-3, 6.2e-3, 40), 5)
    currents = np.concatenate([before, hidden, after, np.repeat([8.49e-3, 3.68e-3, 6e-3], 20)])
    resistance = np.asarray(device.simulate(currents, seed=3)["film_resistance"])
    whole, _ = schemes["composite"].estimate(resistance)
    start, end = before.size + hidden.size, currents.size - 60
    error, added = {}, {}
    for told in (True, False):
        memory = StreamingMemory(schemes["composite"], RANGE)
        run(memory, resistance[: before.size])
        assert memory.known
        if told:
            memory.bridge()
        seen = run(memory, resistance[start:end])
        error[told] = np.abs(seen[:, 0] - np.asarray(whole.deflection)[start:end])
        added[told] = seen[:, 2] - np.asarray(whole.bound)[start:end]
        run(memory, resistance[end:])
        assert memory.known
    assert np.max(error[False]) > 1e-7 and not np.any(added[False]), "it matters, and nobody says so"
    assert np.all(error[True] <= added[True] + 1e-9)
