"""What pages call images, joints and parameters: as tables, files and users do."""

from __future__ import annotations

import html
import re
from typing import Any

from app.records.tables import Measurement
from app.web.pages import environment
from app.web.robot_parameters import joint_rows
from app.web.routes.measurements import in_words
from tests.support.service.signed_in import signed_in
from tests.support.sessions.robot_session import store_robot_session
from tests.support.sessions.stored_sessions import new_session, shoot, store_shots


def test_images_are_called_by_pose_and_cycle_with_their_files(api: Any) -> None:
    session = new_session(api)
    first, second, *_ = store_shots(api, session, shoot(cycles=3))
    with api.installation.database.write() as records:
        records.get_one(Measurement, first).filename = "left <07>.png"
        records.get_one(Measurement, second).filename = None
        pose, cycle = records.get_one(Measurement, second).pose_id, records.get_one(Measurement, second).cycle
        place = f"{records.get_one(Measurement, first).pose_id}, cycle {records.get_one(Measurement, first).cycle}"
    for one in (first, second):
        excluded = {"excluded": {"reason": "a hand"}}
        assert api.client.patch(f"/v1/measurements/{one}", json=excluded).status_code == 200
    for tail in ("repeatability", "next-view", "camera"):
        page = api.client.get(f"/ui/sessions/{session}/{tail}", headers=signed_in(api)).text
        assert "2 of 15 images are not in the figures" in page
        assert f'<a href="/ui/measurements/{first}"><bdi>{place} (left &lt;07&gt;.png)</bdi></a>' in page
        assert f'<a href="/ui/measurements/{second}"><bdi>{pose}, cycle {cycle}</bdi></a>' in page
        assert "<bdi>image 1</bdi>" not in page
        assert "mea_" not in re.sub(r"<[^>]*>", "", page), "no raw id is in a sentence or a list"
    assert re.search(r"largest residuals, rms: <a [^>]+><bdi>P\d, cycle \d</bdi></a> \d", page)

    def warned(around: str) -> bool:
        """Whether the part that is put into this page has the warning, too."""
        head = {
            **signed_in(api),
            "HX-Request": "true",
            "HX-Current-URL": f"http://localhost/ui/sessions/{around}",
        }
        part = api.client.get(f"/ui/sessions/{session}/next-view", headers=head)
        assert part.status_code == 200
        return first in part.text

    assert not warned(f"{session}/camera"), "the page shows it already"
    assert not warned(f"{session}/camera?estimator=pooled")
    assert warned(f"{session}/camera?estimator=per_image"), "another camera, which was not asked for"
    assert warned(session)
    assert warned("ses_other/camera")


def test_an_image_says_along_which_axis_its_position_is_least_certain() -> None:
    calibration = {
        "observability": {"focal_relative_uncertainty": 0.01},
        "pose": {"standard_uncertainty": {"x_mm": 0.2, "y_mm": 0.1, "z_mm": 6.91}},
        "reprojection": {"points": 54},
    }
    assert "the camera's position to 6.9 mm along z, where it is least certain" in in_words(calibration)


def test_an_identification_counts_what_was_measured_and_names_parameters_as_its_table(api: Any) -> None:
    session = store_robot_session(api).id
    answer = api.client.get(f"/v1/sessions/{session}/dh").json()
    held_out = answer["validation"]["held_out_poses"]
    sentences = [one["sentence"] for one in answer["null_space"]]
    assert any("theta1 offset" in one for one in sentences)

    def shown(source: str, weak: list[int]) -> str:
        page = environment().get_template("analyses/_identification.html")
        known = {"document": answer, "joints": joint_rows(answer), "objections": [], "weak_joints": weak}
        around = {"refused": None, "session_id": session, "source": source, "path": "", "image_names": {}}
        return html.unescape(page.render(known | around))

    assert f"({held_out} images)" in shown("images", [])
    assert f"({held_out} readings)" in shown("measured_poses", [])
    assert "theta" not in shown("images", [])
    assert "θ1 and d1 cannot be separated" in shown("images", [])
    if answer["joints"][0]["nominal"] is not None:
        assert "no difference of joint 1 from" in shown("images", [1])
        assert "no difference of joints 1, 2 from" in shown("images", [1, 2])
