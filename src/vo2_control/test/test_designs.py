"""Control laws by name."""

from multiprocessing import Pipe

import pytest
from vo2_control.designer import Designer, Task, make_design
from vo2_control.designs import design_controller
from vo2_models.device.description import described

from vo2_control import designer


def test_a_process_that_designs_ends_quietly_when_its_owner_has_gone(monkeypatch):
    ours, theirs = Pipe()
    monkeypatch.setattr(designer.os, "nice", lambda _: None)
    monkeypatch.setattr(designer.signal, "signal", lambda *_: None)

    def gone(_task):
        ours.close()
        raise ValueError("too late")

    monkeypatch.setattr(designer, "make_design", gone)
    ours.send((1, None))
    assert designer._work(theirs) is None


@pytest.mark.parametrize("operating_a", [0.0, -0.7])
def test_a_law_without_integral_action_works_about_its_operating_current(operating_a):
    values = {"pid.kp": -5e4, "operating_a": operating_a}
    law = design_controller("pid", preset="peltier", sample_period_s=0.125, values=values)
    assert law.update(30e-6, 30e-6) == pytest.approx(operating_a)
    # 1 um above the reference: less heating, that is less negative current
    assert law.update(30e-6, 31e-6) == pytest.approx(min(operating_a + 0.05, 0.05))


def test_a_device_without_published_gains_needs_gains_or_a_model():
    where = {"preset": "peltier_chapter8", "sample_period_s": 0.125}
    with pytest.raises(ValueError, match=r"no gains are published, need pid\.kp, .* or a model"):
        design_controller("pi", values={}, **where)
    assert design_controller("pi", values={"pid.kp": -1.4, "pid.ki": -0.01}, **where)


def test_the_gains_of_chapter_8_are_published_for_its_device():
    where = {"preset": "peltier_chapter8", "sample_period_s": 0.125}
    # as pid_chapter_8.yaml has them
    printed = {
        "pid.kp": -59e3, "pid.ki": -4e3, "pid.kd": -13.6e3, "pid.derivative_filter_s": 0.125,
        "pid.reference_derivative_weight": 1.0,
    }  # fmt: skip
    own, given = (design_controller("pid", values=values, **where) for values in ({}, printed))
    steps = [(30e-6, 31e-6), (30e-6, 30.5e-6), (40e-6, 30e-6)]
    assert [own.update(*step) for step in steps] == [given.update(*step) for step in steps]


def test_a_designer_that_has_died_is_told_however_often_it_is_asked():
    designer = Designer()
    designer._process.kill()
    designer._process.join()
    for _ in range(2):
        designer.ask(None)
        with pytest.raises(ValueError, match="the process that designs has died"):
            designer.answer()
    designer.close()


@pytest.mark.parametrize("kind", ["pi", "pid", "hinf"])
def test_a_model_of_another_device_is_refused(kind):
    with pytest.raises(ValueError, match=r"model\.device: found peltier, need the preset integrated"):
        design_controller(
            kind, preset="integrated", sample_period_s=1e-3, values={"model.device": "peltier", "pid.kp": 1.0}
        )


def test_a_model_without_an_inverse_still_tells_which_set_points_are_out_of_range():
    wire = described(
        {
            "schema": "vo2-device/1",
            "id": "wire",
            "drive": {"channel": "wire_current", "unit": "A", "limits": [0.0, 0.4]},
            "responses": {
                "contraction": {"unit": "m", "range": [0.0, 4e-3]},
                "wire_resistance": {"unit": "ohm", "scale": "log10", "range": [8.0, 10.0]},
            },
            "body": {"kind": "first_order", "power_gain": 80.0, "time_constant": 2.0, "ambient": 23.0},
        },
        "wire",
    )
    values = {"model.device": wire.key, "pid.kp": 20.0, "pid.ki": 15.0}
    design = make_design(Task("pi", wire.key, 0.05, values, False))
    assert design.without
    assert design.reach_m == pytest.approx((-2e-4, 4.2e-3))
