"""What has no name stands in the corrected model all the same, and a fresh recording is predicted better."""

import json

import numpy as np
import pytest
from concealed_devices import calibrated, concealed
from scipy.signal import lfilter
from vo2_identification.bags import write_bag
from vo2_identification.diagnose import main
from vo2_models.device import DeviceModel
from vo2_models.model_file import save_model_parameters
from vo2_models.prediction import predict
from vo2_models.recording import HEATER_CURRENT, TIP_DEFLECTION, Recording


def sagging(recording: Recording) -> Recording:
    """A mount that sags by the fourth power of a late current: nothing of the catalogue."""
    keep = np.exp(-1.0 / 60.0)
    current = recording[HEATER_CURRENT]
    late = lfilter([1.0 - keep], [1.0, -keep], current, zi=[keep * current[0]])[0]
    tip = recording[TIP_DEFLECTION] - 4e-6 * (late / 8e-3) ** 4
    return Recording(recording.time_s, {**recording.channels, TIP_DEFLECTION: tip}, recording.device)


@pytest.mark.slow
def test_the_command_writes_a_correction_of_what_has_no_name(tmp_path) -> None:
    save_model_parameters(tmp_path / "model.yaml", calibrated())
    write_bag(tmp_path / "later", sagging(concealed(seed=31, samples=3000)))
    out = tmp_path / "out"
    given = ["--bag", str(tmp_path / "later"), "--model", str(tmp_path / "model.yaml")]
    assert main([*given, "--output", str(out), "--quiet"]) == 0
    answer = json.loads((out / "diagnosis.json").read_text())
    assert [e["id"] for e in answer["effects"]] == ["unknown"]
    assert any("corrected_model.yaml carries" in text for text in answer["limits"])
    models = [DeviceModel.load(path) for path in (tmp_path / "model.yaml", out / "corrected_model.yaml")]
    assert models[1].effects and not models[0].effects
    # what the file moves is what its head and the answer say
    before, after = (model.scalars for model in models)
    moved = {name for name in before if after[name] != pytest.approx(before[name], rel=1e-3)}
    head = (out / "corrected_model.yaml").read_text().splitlines()[0]
    assert moved and all(name in head for name in moved)
    told = [text for text in answer["limits"] if "fitted beside the answer" in text]
    assert all(
        any(name in text for text in told) for name in moved - {m["constant"] for m in answer["moved"]}
    )
    fresh = sagging(concealed(seed=57))
    error = [predict(model, fresh).channels[TIP_DEFLECTION].error for model in models]
    assert error[1] < 0.5 * error[0]
