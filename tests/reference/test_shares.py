"""The table that thresholds of a diagnosis are set by."""

import json

from benchmarks.concealed.scores.calibrate import shares, text


def test_right_rows_imitators_and_healthy_machines_are_told_apart(tmp_path):
    cases = {
        "a": (["coulomb_friction"], {}, ["coulomb_friction"], 0.993),
        "b": (["outside_catalogue"], {"law": "hertz_contact"}, ["clearance"], 0.95),
        "c": (["rub", "runout"], {"class": {"rub": ["rub", "clearance"]}}, ["clearance", "runout"], 0.9999),
        "d": ([], {}, [], None),
    }
    for name, (missing, more, nearest, share) in cases.items():
        (tmp_path / "set" / "truth").mkdir(parents=True, exist_ok=True)
        (tmp_path / "found" / name).mkdir(parents=True)
        (tmp_path / "set" / "truth" / f"{name}.json").write_text(json.dumps({"missing": missing, **more}))
        near = {"physics": nearest, "share": share, "excess_variance": 1.2} if nearest else None
        data = {"verdict": "consistent", "nearest": near, "fit": {"before": {"excess_variance": 1.07}}}
        (tmp_path / "found" / name / "diagnosis.json").write_text(json.dumps(data))
    found = shares(tmp_path / "set", tmp_path / "found")
    assert [item["right"] for item in found] == [True, False, True, None]
    assert text(found).splitlines()[-3:] == [
        "right rows explain at least 0.9930",
        "wrong ones explain at most 0.9500",
        "where nothing is missing, at most 1.070 times the variance of the noise is left",
    ]
