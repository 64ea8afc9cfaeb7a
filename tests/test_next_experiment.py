"""`diagnose --next`: the proposed experiment on a real graph, its recording, and the diagnosis with both."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from vo2_identification.bags import read_recording, write_bag
from vo2_identification.diagnose.command import continue_with_next, main
from vo2_identification.diagnose.play import play, playable_levels
from vo2_models.device import preset, surrogate_of_temperature, truth
from vo2_models.diagnosis import validate
from vo2_models.diagnosis.next_experiment import Excitable
from vo2_models.diagnosis.result import NextExperiment
from vo2_models.identification.excitation import Excitation, damped_oscillation
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

DEVICE, SEED, DT = "integrated", 11, 1e-3
COLD, HOT = preset(DEVICE).operating_range
LOW, HIGH = (preset(DEVICE).steady_temperature(current) for current in (COLD, HOT))
CREEP = {"creep": {"share": 0.12, "time_constant": 0.1}}
STEPS = Excitable(
    "steps",
    np.atleast_1d(surrogate_of_temperature(DEVICE, np.array([HIGH, LOW, 62.0, HIGH, 57.0, LOW]))),
    0.2,
)


def proposal(excitable=STEPS):
    return NextExperiment("a test", ["creep", "latent_heat"], "excitation", excitable.playable(), "play it")


def quasi_static(effects, *, turns, seconds, seed):
    """A recording of damped loops: current, resistance and deflection, as a rig measures them."""
    levels = damped_oscillation(np.linspace(LOW, HIGH, turns), reversals_only=True)
    rate = float(np.sum(np.abs(np.diff(levels)))) / seconds
    current = surrogate_of_temperature(DEVICE, Excitation.at_rate(levels, rate_per_s=rate).sample(DT))
    found = truth(DEVICE, seed=SEED, effects=effects).simulate(current, seed=seed)
    channels = {name: found[name] for name in (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)}
    return Recording(found.time_s, channels, found.device)


@pytest.mark.slow
def test_the_experiment_is_played_as_designed_and_diagnosed_with_the_first_recording(
    graph, conductor, tmp_path, capfd
):
    graph.start("plant", parameters={"preset": DEVICE, "seed": SEED, "effects": json.dumps(CREEP)})
    _, model = fit_model(
        [quasi_static({}, turns=21, seconds=4.0, seed=1)], DEVICE, plays=6, self_sensing=False
    )
    conductor.wait_for_nodes(["/vo2/plant"])
    bag, output = tmp_path / "first", tmp_path / "diagnosis"
    write_bag(bag, quasi_static(CREEP, turns=3, seconds=1.0, seed=2))
    output.mkdir()
    assert continue_with_next(proposal(), [bag], model, output) == 0

    recording, problems = read_recording(output / "next")
    assert problems == []
    assert list((output / "next").glob("*.mcap"))
    command = recording[COMMANDED_CURRENT]
    designed = STEPS.current(DT, COLD)
    # cold before and after, the safe current at the very end
    begin = int(np.flatnonzero(command == designed[0])[0]) + round(0.03 / DT)
    np.testing.assert_allclose(command[begin : begin + designed.size], designed, rtol=0, atol=1e-9)
    after = command[begin + designed.size :]
    assert after[0] == COLD and after[-1] == 0.0
    np.testing.assert_array_equal(recording[HEATER_CURRENT][1:], command[1:])
    np.testing.assert_allclose(np.diff(recording.time_s), DT, rtol=1e-5)

    answer = json.loads((output / "with_next" / "diagnosis.json").read_text())
    validate(answer)
    assert answer["verdict"] == "differs"
    assert {path.name for path in (output / "with_next").iterdir()} == {
        "diagnosis.json",
        "report.html",
        "corrected_model.yaml",
        ".vo2_outputs.json",
    }
    assert answer["summary"] in capfd.readouterr().out


def test_an_interrupted_experiment_leaves_a_readable_bag_and_the_safe_current(graph, conductor, tmp_path):
    graph.start("plant", parameters={"preset": DEVICE, "seed": SEED})
    conductor.wait_for_nodes(["/vo2/plant"])
    write_bag(tmp_path / "first", quasi_static({}, turns=3, seconds=1.0, seed=2))
    endless = Excitable("endless", np.tile(STEPS.levels_a, 1000), 0.2)
    script = tmp_path / "run.py"
    script.write_text(
        "import sys, pathlib\n"
        "from vo2_identification.diagnose.command import continue_with_next\n"
        "from vo2_models.diagnosis.result import NextExperiment\n"
        f"experiment = NextExperiment('a test', ['a', 'b'], 'excitation', {endless.playable()!r}, 'play it')\n"
        f"folder = pathlib.Path({str(tmp_path)!r})\n"
        f"sys.exit(continue_with_next(experiment, [folder / 'first'], {{'model.device': {DEVICE!r}}}, folder))\n"
    )
    process = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and process.poll() is None:
            if sum(path.stat().st_size for path in (tmp_path / "next").glob("*.mcap")) > 200_000:
                break
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 130, said
    assert "safe current" in said and "Traceback" not in said
    recording, problems = read_recording(tmp_path / "next")
    assert problems == []
    command = recording[COMMANDED_CURRENT]
    assert command[-1] == 0.0
    assert np.all(command[1:-1][np.isfinite(command[1:-1])] >= COLD)
    assert len(recording) > 100
    assert not (tmp_path / "with_next").exists()


def test_without_a_device_of_this_kind_nothing_is_recorded(graph, conductor, tmp_path):
    excitation = proposal().excitation
    with pytest.raises(ValueError, match="nobody publishes /vo2/measurement, waited 1 s"):
        play(excitation, tmp_path / "next", device=DEVICE, sample_period_s=DT, wait_s=1.0)
    graph.start("plant", parameters={"preset": "peltier"})
    conductor.wait_for_nodes(["/vo2/plant"])
    with pytest.raises(ValueError, match="comes from device 'peltier', the model is of 'integrated'"):
        play(excitation, tmp_path / "next", device=DEVICE, sample_period_s=DT)
    assert not (tmp_path / "next").exists()


def test_a_rig_of_a_device_file_is_told_by_its_id(graph, conductor, tmp_path):
    """It calls itself by the path of its file; the model holds the description, which its fit may have completed."""
    document = json.loads(preset(DEVICE).document) | {"id": "o'rig"}
    mine, other = (tmp_path / f"{name}.yaml" for name in ("mine", "other"))
    mine.write_text(json.dumps(document))
    other.write_text(json.dumps(document | {"id": "another"}))
    of_model = preset(mine).completed({"transition": {"heating": [61.0, 3.0]}}).document
    graph.start("plant", parameters={"preset": str(mine), "seed": SEED})
    conductor.wait_for_nodes(["/vo2/plant"])
    with pytest.raises(ValueError, match=r"mine.yaml', the model is of 'another'"):
        play(proposal().excitation, tmp_path / "next", device=preset(other).document, sample_period_s=DT)
    assert play(proposal().excitation, tmp_path / "next", device=of_model, sample_period_s=DT)
    recording, problems = read_recording(tmp_path / "next")
    assert problems == [] and recording.device == str(mine)
    assert np.nanmax(recording[COMMANDED_CURRENT]) == np.max(STEPS.levels_a)


def test_a_device_that_another_node_commands_is_left_alone(graph, conductor, tmp_path):
    graph.start("plant", parameters={"preset": DEVICE})
    graph.start("identifier", parameters={"preset": DEVICE, "fit": False, "excitation.level": 300})
    conductor.wait_for_nodes(["/vo2/plant", "/vo2/identifier"])
    conductor.trigger("/vo2/identifier/start")
    with pytest.raises(ValueError, match=r"another node commands on /vo2/command \(identifier\)"):
        play(proposal().excitation, tmp_path / "next", device=DEVICE, sample_period_s=DT)
    assert not (tmp_path / "next").exists()


def test_levels_beyond_the_device_are_refused():
    with pytest.raises(ValueError, match=r"found 0\.0036.* to 0\.02 A, need 0 to 0\.01278 A"):
        playable_levels({"kind": "levels", "levels_a": [COLD, 0.02]}, DEVICE)
    with pytest.raises(ValueError, match="need kind levels"):
        playable_levels({"current_a": [0.004]}, DEVICE)


def test_where_nothing_can_be_played_it_says_what_to_do(tmp_path, capsys):
    assert continue_with_next(None, [], {}, tmp_path) == 0
    assert "nothing is left to separate" in capsys.readouterr().out
    by_hand = NextExperiment("why", ["creep", "latent_heat"], "manual", None, "Swap the glue.")
    assert continue_with_next(by_hand, [], {}, tmp_path) == 0
    assert "Swap the glue." in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_an_earlier_experiment_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "next").mkdir()
    assert main(["--bag", "b", "--model", "m.yaml", "--output", str(tmp_path), "--next"]) == 2
    assert "exists already" in capsys.readouterr().err
