"""Commanded and measured poses as CSV: the same as the JSON list, or refused with the place."""

from __future__ import annotations

import csv
import io
from typing import Any

import pytest

from app.client.pose_rows import csv_rows, decoded, pose_of_cells

HEADERS = {"Content-Type": "text/csv; charset=utf-8"}
POSES = (
    "pose_id,position_x_mm,position_y_mm,position_z_mm,roll_deg,joint_angles_deg,approach\r\n"
    'P1,1.5,-2,3e2,90,"0,10.5,-20",+x\r\n'
    "'-P2,,,,,,\r\n"
)


def send(api: Any, session: str, kind: str, text: str | bytes) -> Any:
    return api.client.post(f"/v1/sessions/{session}/{kind}", content=text, headers=HEADERS)


def test_commanded_poses_come_from_a_spreadsheet(api: Any) -> None:
    session = api.make_session()
    response = send(api, session, "poses", "\ufeff" + POSES)
    assert response.status_code == 200, response.text
    first, second = response.json()["items"]
    nothing = dict.fromkeys(
        ("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg", "approach")
    )
    assert first == {
        **nothing,
        "pose_id": "P1",
        "position_mm": [1.5, -2.0, 300.0],
        "roll_deg": 90.0,
        "joint_angles_deg": [0.0, 10.5, -20.0],
        "approach": "+x",
    }
    assert second == {**nothing, "pose_id": "-P2"}
    listed = api.client.get(f"/v1/sessions/{session}/poses").json()["items"]
    assert listed == [first, second]


def test_measured_poses_come_from_a_spreadsheet(api: Any) -> None:
    session = api.make_session()
    text = "pose_id,cycle,position_mm,rotation,covariance\nP1,2,1 2 3,1 0 0; 0 1 0; 0 0 1,\n"
    response = send(api, session, "measured-poses", text)
    assert response.status_code == 200, response.text
    (item,) = response.json()["items"]
    assert (item["cycle"], item["position_mm"], item["covariance"]) == (2, [1.0, 2.0, 3.0], None)
    assert item["rotation"] == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    "text",
    [
        "pose_id,x_mm,y_mm,z_mm,roll_deg,j1_deg,j2_deg\nP1,1.5,-2,300,90,0.5,-20\nP2,,,,,,\n",
        "pose_id;x_mm;y_mm;z_mm;roll_deg;j1_deg;j2_deg\nP1;1,5;-2;300;90,0;0,5;-20\nP2;;;;;;\n",
        "pose_id;position_x_mm;position_y_mm;position_z_mm;roll_deg;joint_angles_deg\n"
        'P1;1,5;-2;300;90;"0,5; -20"\nP2;;;;;\n',
        "pose_id\tposition_mm\troll_deg\tjoint_angles_deg\nP1\t1,5 -2 300\t90\t0,5 -20\nP2\t\t\t\n",
        "sep=;\r\npose_id;position_mm;roll_deg;joint_angles_deg\r\nP1;1,5 -2 300;90;0,5 -20\r\nP2;;;\r\n",
        "pose_id\tposition_mm\troll_deg\tj1_deg\tj2_deg\nP1\t1,5 -2 300\t90\t0,5\t-20\nP2\t\t\t\t\n".encode(
            "utf-16"
        ),
    ],
)
def test_names_and_decimal_commas_of_spreadsheets_are_read(api: Any, text: str | bytes) -> None:
    first, second = send(api, api.make_session(), "poses", text).json()["items"]
    assert first["position_mm"] == [1.5, -2.0, 300.0]
    assert (first["roll_deg"], first["joint_angles_deg"]) == (90.0, [0.5, -20.0])
    assert {value for name, value in second.items() if name != "pose_id"} == {None}
    # The command line reads the same files.
    rows, delimiter = csv_rows(decoded(text.encode() if isinstance(text, str) else text))
    fields = pose_of_cells(dict(zip(next(rows), next(rows), strict=True)), delimiter)
    assert fields == {name: value for name, value in first.items() if value is not None}


@pytest.mark.parametrize("kind", ["poses", "measured-poses"])
def test_a_list_is_answered_as_a_table_that_can_be_sent_again(api: Any, kind: str) -> None:
    first, second = api.make_session(), api.make_session()
    items: list[dict[str, Any]] = [
        {
            "pose_id": f"P{i}",
            "position_mm": [-100.25 * i, 200.0, 3e-7],
            "joint_angles_deg": [-10.5, 1.0 / 3.0],
        }
        for i in range(3)
    ]
    if kind == "measured-poses":
        turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        items = [{**item, "cycle": 2, "rotation": turn} for item in items]
    assert api.client.post(f"/v1/sessions/{first}/{kind}", json=items).status_code == 200
    address = f"/v1/sessions/{first}/{kind}"
    table = api.client.get(address, headers={"Accept": "text/csv"})
    assert table.headers["content-type"].startswith("text/csv")
    assert "Accept" in table.headers["vary"]
    assert "link" not in table.headers
    assert send(api, second, kind, table.content).status_code == 200, table.text

    def stored(session: str) -> list[dict[str, Any]]:
        found = api.client.get(f"/v1/sessions/{session}/{kind}").json()["items"]
        return [{name: value for name, value in item.items() if name != "id"} for item in found]

    assert stored(second) == stored(first)
    page = api.client.get(f"{address}?limit=2", headers={"Accept": "text/csv"})
    assert len(page.text.splitlines()) == 3
    following = page.headers["link"].partition(">")[0].removeprefix("<")
    rest = api.client.get(following, headers={"Accept": "text/csv"})
    assert page.text + "".join(rest.text.splitlines(keepends=True)[1:]) == table.text


@pytest.mark.parametrize(
    "path",
    [
        *("targets", "robots", "sessions", "reports", "audit", "keys", "qualifications", "webhooks"),
        *("sessions/{}/measurements", "sessions/{}/reports"),
    ],
)
def test_every_list_is_a_table_too(api: Any, grey_png: bytes, path: str) -> None:
    session = api.make_session()
    measurement = api.put_image(session, grey_png, pose_id="P7").json()
    address = f"/v1/{path.format(session)}"
    items = api.client.get(address).json()["items"]
    answer = api.client.get(address, headers={"Accept": "text/csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(answer.text, newline="")))
    assert [row["id"] for row in rows] == [item["id"] for item in items]
    if path.endswith("measurements"):
        assert (rows[0]["id"], rows[0]["pose_id"], rows[0]["burst"]) == (measurement["id"], "P7", "1")
    refused = api.client.get(f"{address}?limit=0", headers={"Accept": "text/csv"})
    assert refused.headers["content-type"].startswith("application/problem+json")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "invalid_csv"),
        (b"\xff\xfe", "invalid_csv"),
        ("pose_id,roll_deg\nP1\n", "invalid_csv"),
        ("pose_id,pose_id\nP1,P1\n", "invalid_csv"),
        ("pose_id,position_x_mm\nP1,1\n", "invalid_csv"),
        ("pose_id,x_mm,y_mm,z_mm,position_x_mm\nP1,1,1,1,1\n", "invalid_csv"),
        ("pose_id,j1_deg,j3_deg\nP1,1,1\n", "invalid_csv"),
        ("pose_id,j1_deg,joint_angles_deg\nP1,1,1\n", "invalid_csv"),
        ("pose_id,j1_deg,j2_deg\nP1,,1\n", "invalid_request"),
        ('pose_id\n"P1\n', "invalid_csv"),
        ("pose_id,roll\nP1,1\n", "invalid_request"),
        ("pose_id,roll_deg\nP1,x\n", "invalid_request"),
        ("pose_id,roll_deg\nP1,1_0\n", "invalid_request"),
        ("pose_id;x_mm;y_mm;z_mm\nP1;1.234;0;1\nP2;812,5;0;1\n", "invalid_csv"),
        ("pose_id;position_mm;roll_deg\nP1;1 2 3.5;0,5\n", "invalid_csv"),
        ("pose_id,roll_deg\nP1,nan\n", "invalid_request"),
        ("pose_id,position_mm\nP1,1 2\n", "invalid_request"),
        ("roll_deg\n1\n", "invalid_request"),
        ("pose_id\nP1\nP1\n", "duplicate_pose"),
    ],
)
def test_a_table_that_cannot_be_is_refused_and_nothing_stored(api: Any, text: str, code: str) -> None:
    session = api.make_session()
    response = send(api, session, "poses", text)
    assert (response.status_code, response.json()["code"]) == (422, code)
    assert response.json()["errors"]
    assert api.client.get(f"/v1/sessions/{session}/poses").json()["items"] == []


def test_other_lists_take_json_alone(api: Any) -> None:
    response = send(api, api.make_session(), "images/missing", "pose_id\nP1\n")
    assert response.status_code == 415
