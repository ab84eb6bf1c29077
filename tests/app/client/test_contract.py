"""The client against the contract: what it calls, sends and reads is in openapi.json, as generated clients have it."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from app.cli.demo.session import joint_rows
from app.client import (
    ClientError,
    ServiceClient,
    Session,
    collect_results,
    describe_measured,
    find_or_make_session,
    find_robot,
    find_session,
    plan_files,
    session_cameras,
    upload_files,
)
from core.simulation import KR5_ARC
from tests.support.contract.checked_transport import CheckedAnswer, CheckedTransport
from tests.support.contract.contract import Contract
from tests.support.service.service import ApiMaker

PROJECT = Path(__file__).parents[3]
METHODS = {
    **{"get": "get", "items": "get", "get_bytes": "get"},
    **{"create": "post", "put": "put", "change": "patch", "delete": "delete"},
}
"""Methods of `ServiceClient` that take a path, with the HTTP method of each."""
IN_HEADERS = {"accept"}
"""Arguments of these methods that are no query."""
FREE = "{}"


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract(json.loads((PROJECT / "openapi.json").read_text(encoding="utf-8")))


@dataclass(frozen=True)
class Call:
    """A call of `ServiceClient` in the sources: where, the HTTP method, the path with `{}` for values, the query."""

    place: str
    method: str
    path: str
    query: frozenset[str]


def calls(folder: Path) -> Iterator[Call]:
    """Yield each call with its path written out, here or in the line that names it."""
    for source in sorted(folder.rglob("*.py")):
        tree = ast.parse(source.read_text(encoding="utf-8"))
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            named = {
                target.id: path
                for node in ast.walk(function)
                if isinstance(node, ast.Assign) and (path := written(node.value, {})) is not None
                for target in node.targets
                if isinstance(target, ast.Name)
            }
            for node in ast.walk(function):
                if (
                    not isinstance(node, ast.Call)
                    or not isinstance(node.func, ast.Attribute)
                    or not node.args
                ):
                    continue
                name, path = node.func.attr, written(node.args[0], named)
                if name in METHODS and path is not None and path.startswith("/v1/"):
                    query = frozenset(word.arg for word in node.keywords if word.arg) - IN_HEADERS
                    place = f"{source.relative_to(PROJECT)}:{node.lineno}"
                    yield Call(place, METHODS[name], path, query)


def written(node: ast.expr, named: dict[str, str]) -> str | None:
    """Return a text, with `{}` for what is put into it; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else FREE for part in node.values)
    return named.get(node.id) if isinstance(node, ast.Name) else None


def fits(path: str, template: str) -> bool:
    """Return whether a written path may be one of an operation's."""
    parts, segments = path.split("/"), template.split("/")
    return len(parts) == len(segments) and all(
        segment.startswith("{") or re.fullmatch(re.escape(part).replace(re.escape(FREE), ".+"), segment)
        for part, segment in zip(parts, segments, strict=True)
    )


@pytest.mark.parametrize("package", ["app/client", "app/cli"])
def test_each_call_is_an_operation_with_its_query(contract: Contract, package: str) -> None:
    found = list(calls(PROJECT / package))
    assert len(found) >= 5
    for call in found:
        operations = [o for o in contract.operations if o.method == call.method and fits(call.path, o.path)]
        assert operations, f"{call.place}: the contract has no {call.method} {call.path}"
        assert any(call.query <= o.query_names for o in operations), f"{call.place}: {sorted(call.query)}"


@pytest.mark.slow
def test_all_that_the_client_sends_and_reads_is_in_the_contract(
    contract: Contract, serve_api: ApiMaker, board_png: bytes, tmp_path: Path
) -> None:
    (tmp_path / "P1").mkdir()
    (tmp_path / "P1" / "0001.png").write_bytes(board_png)
    (tmp_path / "P1" / "0002.png").write_bytes(board_png[:-100])
    transport = CheckedTransport(contract)
    with serve_api(workers=1, lent_workers=True) as api:
        url, key = str(api.client.base_url), api.client.headers["authorization"].removeprefix("Bearer ")
        with ServiceClient(url, key, transport=transport) as client:
            robot_id = client.create("/v1/robots", {"name": "KR5", "joints": joint_rows(KR5_ARC)})["id"]
            assert find_robot(client, "KR5")["id"] == robot_id
            session_id, _ = find_or_make_session(client, "shift", "chessboard:9x6:25")
            assert find_or_make_session(client, "shift", "chessboard:9x6:25")[0] == session_id
            assert find_session(client, "shift")["id"] == session_id
            images = plan_files(tmp_path).images
            outcomes = upload_files(client, session_id, images, focus_group="default")
            assert [outcome.status for outcome in outcomes] == ["sent", "sent"]
            again = upload_files(client, session_id, images)
            assert [outcome.status for outcome in again] == ["present", "present"]
            result = collect_results(client, session_id, outcomes)
            assert (len(result.succeeded), len(result.failed), result.duplicates) == (1, 1, [])
            assert describe_measured(result.measurements, session_cameras(client, session_id)[0])
            reading = {"pose_id": "P1", "position_mm": [1.0, 2.0, 3.0]}
            assert client.put_measured_poses(session_id, [reading])["items"]
            path = f"/v1/sessions/{session_id}"
            assert client.delete(f"{path}/measured-poses", pose_id="P1") is not None
            client.put(f"{path}/poses/P2", {"joint_angles_deg": [0.0]})
            client.change(path, {"name": "night shift"})
            assert client.get_bytes(f"/v1/measurements/{result.succeeded[0]['id']}/thumbnail")
            with pytest.raises(ClientError, match="target_in_use"):
                client.delete(f"/v1/targets/{client.get(path)['target_ids'][0]}")
            session = Session(client, session_id)
            assert session.document()["name"] == "night shift"
            assert sorted(m.measured for m in session.measurements()) == [False, True]
            assert session.intrinsics().rows
            session.delete()
    of_client = {
        (call.method, call.path)
        for call in calls(PROJECT / "app" / "client")
        if not call.place.startswith(("app/client/commands", "app/client/watch"))
    }
    used = [operation for operation in contract.operations if operation.operation_id in transport.used]
    for method, written_path in of_client:
        assert any(o.method == method and fits(written_path, o.path) for o in used), (
            f"{written_path} was not called"
        )


def test_a_key_that_the_contract_does_not_have_is_noticed(contract: Contract) -> None:
    schema = contract.at("GET", "/v1/sessions/s").schema("200")
    known = contract.resolve(schema)["properties"]
    answer = CheckedAnswer({"id": "s"}, known)
    assert answer["id"] == "s"
    for read in (answer.__getitem__, answer.get, answer.__contains__):
        with pytest.raises(AssertionError, match="the contract has no"):
            read("identifier")
    with pytest.raises(AssertionError, match="the contract has no"):
        contract.at("GET", "/v1/session/s")
    assert contract.violations({"id": "s"}, schema)
