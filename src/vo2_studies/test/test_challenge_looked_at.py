"""Cases of looked-at draws that a version answered wrongly: they tell about that version's fault, and prove nothing."""

import pytest
from vo2_identification.bags import read_recording
from vo2_models.diagnosis import study
from vo2_models.identification.model_fit import fit_model
from vo2_studies.challenge.draw import draw_case
from vo2_studies.challenge.plan import Choice, plan_case
from vo2_studies.challenge.runner import Paths, write_case


@pytest.mark.slow
def test_where_the_loops_follow_a_colder_room_no_gain_has_moved_and_nothing_is_named(tmp_path) -> None:
    """Plain steps ended 0.2 K from the room, with a weaker heater, and what was left was named as a light.

    Another day of a device whose grains see their mean field, its commands stamped late: `--kinds one,moved,day --leave-out
    avalanches --condition all --samples 5000 --seed 26112813`, case 43.
    """
    choice = Choice(
        leave_out="avalanches", kinds=("one", "moved", "day"), condition="all", samples=(5000, 5000)
    )
    case = draw_case(26112813, plan_case(26112813, 43, choice))
    device = write_case(case, Paths(tmp_path))
    calibration, later = (
        read_recording(Paths(tmp_path).case(43) / name)[0] for name in ("calibration", "test")
    )
    _, model = fit_model([calibration], device, self_sensing=False)
    decision = study([later], model).decision
    assert decision.verdict == "drifted" and decision.chosen is None
    moved = dict(zip([c.name for c in decision.drift.constants], decision.drift.move, strict=True))
    assert moved["thermal.ambient"] == pytest.approx(case.answer["day"]["ambient"], abs=0.1)
    assert abs(moved["thermal.square_gain"]) < 0.004 * model["model.thermal.square_gain"]
