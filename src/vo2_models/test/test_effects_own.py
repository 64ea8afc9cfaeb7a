"""A user's own effect file: written from the skeleton, loaded, simulated; files that are not sound are told with their place."""

import os
import subprocess
import sys

import pytest
from vo2_models.effects.catalogue import check_hooks, load_effect, module_of
from vo2_models.effects.skeleton import main, skeleton

RUN = """
import numpy as np
from vo2_models.device import truth
from vo2_models.effects import effects
plain = truth("integrated", domains=50).simulate(np.full(300, 4.5e-3), noise=False)
own = {"slow_anchor": {"share": 0.05, "time_constant": 0.1}}
with_it = truth("integrated", domains=50, effects=own).simulate(np.full(300, 4.5e-3), noise=False)
rise = plain["true_temperature"] - 22.0
print(*((with_it["true_temperature"] - 22.0) / rise)[[20, -1]])
"""


def run(folder, code=RUN):
    environment = {
        **os.environ,
        "VO2_EFFECTS": str(folder),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)


def edit(file):
    """Change what the hook of the skeleton does: the share that comes late is there at once."""
    text = file.read_text()
    changed = text.replace("return -share, share * late", "return 0.0 * share, share * late")
    assert changed != text
    file.write_text(changed)


@pytest.mark.slow
def test_the_skeleton_acts_and_an_edit_of_its_hook_is_seen(tmp_path):
    """Two whole chains are compiled; the page `add_an_effect` compiles one, and the next test sees an edit without that."""
    assert main(["slow_anchor", "--output", str(tmp_path)]) == 0
    shown = run(tmp_path)
    assert shown.returncode == 0, shown.stderr
    early, late = map(float, shown.stdout.split())
    assert early == pytest.approx(0.95 + 0.05 * (1 - pow(2.718281828, -0.21)), abs=2e-3)
    assert late == pytest.approx(1.0 - 0.05 * pow(2.718281828, -3.0), abs=2e-3)
    edit(tmp_path / "slow_anchor.py")
    assert float(run(tmp_path).stdout.split()[1]) == pytest.approx(late + 0.05, abs=1e-9)


def test_the_hooks_of_the_skeleton_are_its_equation_and_their_edit_asks_for_other_kernels(tmp_path):
    """What is compiled and kept stands in a folder that is named by what it was compiled from."""
    code = (
        "from vo2_models.device import chain\nfrom vo2_models.effects import effect\n"
        "hooks, late = effect('slow_anchor').hooks, 0.0\n"
        "for _ in range(20): late = hooks['advance'](1.0, 5e-3, late, 0.1)\n"
        "print(*hooks['body'](late, 0.05), hooks['settled'](1.0), chain.run_chain._cache.cache_path)"
    )
    assert main(["slow_anchor", "--output", str(tmp_path)]) == 0
    shown = [run(tmp_path, code) for _ in range(2)]
    edit(tmp_path / "slow_anchor.py")
    shown.append(run(tmp_path, code))
    assert [each.stderr for each in shown] == [""] * 3
    first, again, edited = (each.stdout.split() for each in shown)
    assert [float(each) for each in first[:3]] == pytest.approx(
        [-0.05, 0.05 * (1 - pow(2.718281828, -1)), 1.0]
    )
    assert again == first
    assert float(edited[0]) == 0.0 and edited[3] != first[3]


def test_the_skeleton_is_not_written_over_anything(tmp_path, capsys):
    (tmp_path / "mine.py").write_text("kept")
    assert main(["mine", "--output", str(tmp_path)]) == 2
    assert (tmp_path / "mine.py").read_text() == "kept"
    assert main(["Not-A-Name", "--output", str(tmp_path)]) == 2
    assert main(["creep", "--output", str(tmp_path / "own")]) == 2 and not (tmp_path / "own").exists()
    first, second, third = capsys.readouterr().err.splitlines()
    assert "mine.py: is there already" in first
    assert "found 'Not-A-Name', need small letters" in second
    assert "found 'creep', which the catalogue has already" in third


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("def body(", "def bodies("), "found no hook, need a function named one of drive"),
        (("def settled(drive):", "def rests(drive):"), "state late: found no settled value"),
        (("def advance(", "def moves("), "found states but no hook advance"),
        (('"1", "part of', '"", "part of'), "parameter share: found no unit"),
        (("-0.5, 0.5", "0.5, -0.5"), "parameter share: found bounds 0.5 to -0.5"),
        (
            ('arrives late", -0.5, 0.5', 'arrives late"'),
            "parameter share: found no lower and upper bound, need what is physically possible, in 1",
        ),
        (
            ('arrives late", -0.5, 0.5', 'arrives late", -0.5'),
            "parameter share: found no lower and upper bound",
        ),
        (
            (
                'share", 0, "1", "part of the steady temperature rise that arrives late", -0.5, 0.5',
                'share", 0',
            ),
            "parameter share: found no unit, need an SI unit text",
        ),
        (("def body(late, share)", "def body(late, share, wind)"), "hook body: found the argument 'wind'"),
        (('stage="thermal"', 'stage="weather"'), "stage: found 'weather'"),
        (('needs=("body",)', 'needs=("luck",)'), "needs: found 'luck'"),
        (('id="slow_anchor"', 'id="other"'), "found id 'other', need the file's name"),
        (("EFFECT = Effect(", "EFFECTS = Effect("), "EFFECT: found NoneType"),
        (("import math", "import no_such_module"), "cannot be imported (ModuleNotFoundError"),
        (("slow_anchor", "creep"), "found the id 'creep' twice"),
        (
            ("return -share, share * late", "return -share, share * lat"),
            "hook body: cannot be run (NameError: name 'lat' is not defined)",
        ),
        (("parameters=(", "parameters=(None,"), "EFFECT: found a value of another type than Effect says"),
        (
            ('share", 0, "1"', 'share", 0.9, "1"'),
            "parameter share: found the neutral value 0.9, need one within -0.5 to 0.5",
        ),
        (
            ("channels=HEAT", 'channels=("resistance",)'),
            "channels: found 'resistance', need a tuple of some of heater_current",
        ),
        (('{"share": (', '{"shar": ('), "typical: integrated: found shar, need parameters of the effect"),
        (("import math", "import math; raise SystemExit(0)"), "cannot be imported (SystemExit"),
    ],
)
def test_a_file_that_is_not_sound_is_told_with_its_place(tmp_path, change, said):
    text = skeleton("slow_anchor").replace(*change)
    name = "creep.py" if change[1] == "creep" else "slow_anchor.py"
    (tmp_path / name).write_text(text)
    code = "from vo2_models.effects import effects\ntry:\n    effects()\nexcept ValueError as error:\n    print(error)"
    shown = run(tmp_path, code).stdout
    assert str(tmp_path / name) in shown and said in shown


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("    value * (1.0 - leak)", "hook terminals: found None, need resistance at the terminals"),
        ("    return value, leak", "hook terminals: found (10000.0, 0.1), need resistance"),
        ("    return 1.02 * value", "hook terminals: found 10200 of 10000 with neutral parameters, need 10000"),
    ],
)  # fmt: skip
def test_a_hook_that_gives_no_number_or_acts_while_it_is_off_is_told(tmp_path, body, said):
    (tmp_path / "leak.py").write_text(
        "from vo2_models.effects.record import Effect, constant_of\n"
        "EFFECT = Effect(id='leak', stage='terminals', channels=('film_resistance',),\n"
        "    typical={'integrated': {'leak': (0.1, 0.2)}},\n"
        "    parameters=(constant_of('leak', 0, '1', 'lost share', 0, 1),),\n"
        "    equation='', excitation='', source='', statement='')\n"
        f"def terminals(value, leak):\n{body}\n"
    )
    code = "from vo2_models.effects import effects\ntry:\n    effects()\nexcept ValueError as error:\n    print(error)"
    assert said in run(tmp_path, code).stdout


OWN_LAG = """
import math
from vo2_models.effects.record import ALL, Effect, State, constant_of

EFFECT = Effect(
    id="own_lag", stage="{stage}", parameters=(constant_of("tau", 0, "s", "time constant", 0, 10),), channels=ALL,
    states=(State("late", "1", "what has arrived"),), typical={{"integrated": {{"tau": (1e-3, 5e-3)}}}},
    equation="tau dy/dt = u - y", excitation="steps", source="any text", statement="One value comes late.",
)

def settled({quantity}):
    return {quantity}

def advance({quantity}, late, period, tau):
    return late - math.expm1(-period / tau) * ({quantity} - late)

def {hook}(late):
    return late
"""
SHARE = "(0.03, 0.1)"
BODY = "    return -share, share * late\n"
ANOTHER = "settled=0.0), State('other', 'K', 'a second one', settled=0.0),)"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (f'{{"integrated": {{"share": {SHARE}, "time_constant": (0.02, 0.2)}}}}', "{}", "typical: found no range, need one"),
        (SHARE, "(0.1, 0.03)", "typical: integrated: share: found (0.1, 0.03), need (low, high) above 0 and within -0.5 to 0.5"),
        (SHARE, "(0.03, 5.0)", "share: found (0.03, 5.0), need (low, high) above 0 and within -0.5 to 0.5"),
        (SHARE, "(0.03,)", "share: found (0.03,), need (low, high)"),
        ('{"integrated"', '{"watch"', "typical: found 'watch', need one of integrated, peltier"),
        ('{"integrated"', '{"integrated:tip_deflection"', "typical: found 'integrated:tip_deflection', need one of"),
        ('0, "1", "part', '0, "furlong", "part', "parameter share: unit: found 'furlong', need parts of 1, rad"),
        ("    return late - math", "    return late, late - math", "hook advance: found (25.0, "),
        ('slow body"),)', f'slow body", {ANOTHER}', "hook settled: found 25.0, need 2 numbers: late, other"),
        ("    return drive\n", '    return "rest"\n', "hook settled: found 'rest', need 1 number: late"),
        ("    return drive\n", "    return drive * math.nan\n", "hook settled: found nan at magnitudes of typical"),
        ("(drive - late)", "(drive - late) + math.nan", "hook advance: found nan at magnitudes of typical, need finite"),
        (BODY, "    return 'warm'\n", "hook body: found 'warm', need change of the body's temperature per kelvin"),
        (BODY, "    share * late\n", "hook body: found None, need change of the body's temperature per kelvin"),
        (BODY, "    return 0.01 - share, 0.0\n", "hook body: found 0.01 of 0 with neutral parameters, need 0"),
        (BODY, f"    if late < 1e3:\n    {BODY}", "hook body: found None on one of its ways, need a value on each"),
    ],
)  # fmt: skip
def test_what_would_break_in_use_is_refused_as_the_file_is_loaded(tmp_path, old, new, said):
    file = tmp_path / "slow_anchor.py"
    text = skeleton("slow_anchor")
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(ValueError) as error:
        check_hooks(load_effect(module_of(file)))
    assert str(error.value).startswith(f"{file}: ") and said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_hook_with_memory_that_is_not_off_at_its_neutral_values_is_refused(tmp_path):
    file = tmp_path / "own_lag.py"
    text = OWN_LAG.format(stage="structure", hook="structure", quantity="deflection")
    file.write_text(text)
    check_hooks(load_effect(module_of(file)))
    file.write_text(text.replace("return late\n", "return 1.01 * late\n"))
    with pytest.raises(ValueError, match=r"hook structure: found 1.01e-05 of 1e-05 with neutral parameters"):
        load_effect(module_of(file))


def test_an_advance_that_gives_one_of_two_states_is_refused(tmp_path):
    file = tmp_path / "own_lag.py"
    text = OWN_LAG.format(stage="structure", hook="structure", quantity="deflection")
    text = text.replace('"what has arrived"),)', f'"what has arrived", {ANOTHER}').replace(
        "def settled", "def rests"
    )
    file.write_text(text)
    with pytest.raises(ValueError, match=r"own_lag.py: hook advance: found .*, need 2 numbers: late, other"):
        load_effect(module_of(file))


ASKED_FOR = """
import argparse, os
from vo2_models.effects.catalogue import add_effects_option
folder = os.environ.pop("VO2_EFFECTS")
parser = argparse.ArgumentParser(prog="fit")
add_effects_option(parser)
if {used}:
    import vo2_models.device.generated
parser.parse_args(["--effects", folder])
"""


@pytest.mark.parametrize(
    ("used", "told"), [(False, "slow_anchor.py: EFFECT: found int"), (True, "need a new process")]
)
def test_an_effect_file_that_is_wrong_or_comes_too_late_is_told_in_one_line(tmp_path, used, told):
    (tmp_path / "slow_anchor.py").write_text("EFFECT = 3")
    done = run(tmp_path, ASKED_FOR.format(used=used))
    assert done.returncode == 2
    assert done.stderr.startswith("fit: ") and done.stderr.count("\n") == 1
    assert told in done.stderr


def test_a_folder_that_is_not_there_is_told(tmp_path):
    code = "from vo2_models.effects import effects\ntry:\n    effects()\nexcept ValueError as error:\n    print(error)"
    assert "found no such folder" in run(tmp_path / "nowhere", code).stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "hook", "quantity", "channel"),
    [
        ("driver", "drive", "current", "heater_current"),
        ("terminals", "terminals", "value", "film_resistance"),
        ("structure", "structure", "deflection", "tip_deflection"),
    ],
)
def test_a_lag_of_ones_own_works_at_every_stage_that_passes_a_value_on(
    tmp_path, stage, hook, quantity, channel
):
    (tmp_path / "own_lag.py").write_text(OWN_LAG.format(stage=stage, hook=hook, quantity=quantity))
    code = (
        "import numpy as np\nfrom vo2_models.device import truth\n"
        "def late(**e): return truth('integrated', domains=50, effects=e).simulate(np.r_[np.zeros(50), np.full(50, 4e-3)], "
        f"noise=False)[{channel!r}]\n"
        "plain, run = late(), late(own_lag={'tau': 3e-3})\n"
        "decay, expected = np.exp(-1 / 3), [plain[0]]\n"
        "for u in plain[1:]: expected.append(u + (expected[-1] - u) * decay)\n"
        "print(np.max(np.abs(run - expected)) / np.ptp(plain), 0)"
    )
    shown = run(tmp_path, code)
    assert shown.returncode == 0, shown.stderr
    assert float(shown.stdout.split()[0]) < 1e-9
