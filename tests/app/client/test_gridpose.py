"""The Python client: the programs of the docs, and the same calls in an event loop."""

from __future__ import annotations

import asyncio
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import app.client
from app.client import AsyncGridpose, ClientError, Gridpose
from app.client.commands.access import ReadAccess, UploadAccess
from app.client.credentials import find_key, forget_key, save_key, saved_key
from tests.support.service.service import Api, ApiMaker
from tests.system.faults.images import image

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def api(serve_api: ApiMaker) -> Iterator[Api]:
    with serve_api(workers=1, lent_workers=True) as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two poses of two images each."""
    for number in range(4):
        path = tmp_path / "images" / f"P{number % 2 + 1}" / f"{number // 2 + 1}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(image(8 * number + number % 2))
    return tmp_path


def program_of(document: Path) -> str:
    """Return the code of a page's block, or of a notebook's cells."""
    text = document.read_text(encoding="utf-8")
    if document.suffix == ".ipynb":
        return "\n".join("".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "code")
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return str(code)


@pytest.mark.slow
@pytest.mark.parametrize("document", ["shop-floor.md", "repeatability.ipynb"])
def test_the_documented_program_reads_the_table(
    document: str,
    api: Api,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = program_of(DOCS / document).replace("Cell 7", document)
    installed = ModuleType("gridpose")
    installed.Gridpose = Gridpose  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gridpose", installed)
    monkeypatch.setenv("GRIDPOSE_KEY", api.client.headers["authorization"].removeprefix("Bearer "))
    monkeypatch.chdir(folder)
    exec(compile(code.replace("http://measuring-pc:8000", str(api.client.base_url)), document, "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    printed = [line.split() for line in lines if re.match(r"(\d+\.png|P\d) ", line)]
    assert sorted(words[1:3] for words in printed[:4]) == [["P1", "True"]] * 2 + [["P2", "True"]] * 2
    assert [words[:2] for words in printed[4:]] == [["P1", "2"], ["P2", "2"]]
    assert (folder / "scatter.svg").read_bytes().startswith(b"<")


def test_the_same_calls_wait_in_an_event_loop(api: Api) -> None:
    key = api.client.headers["authorization"].removeprefix("Bearer ")

    async def use() -> None:
        async with AsyncGridpose(str(api.client.base_url), key) as gridpose:
            session = await gridpose.session("loop", target="chessboard:7x5:10")
            assert session.id in [one.id for one in await gridpose.sessions()]
            await session.put_poses([{"pose_id": "P1", "position_mm": [1.0, 2.0, 3.0]}])
            assert (await session.document())["name"] == "loop"
            assert await session.wait() == []
            assert len(await gridpose.targets()) >= 1
            assert await gridpose.robots() == []
            with pytest.raises(ClientError) as caught:
                await session.repeatability()
            assert caught.value.status == 409
            await session.delete()

    asyncio.run(use())


@pytest.mark.parametrize("name", ["Session", "Gridpose"])
def test_both_forms_have_the_same_calls(name: str) -> None:
    def calls(kind: type) -> set[str]:
        return {call for call in vars(kind) if not call.startswith("_")}

    sync, of_loop = getattr(app.client, name), getattr(app.client, f"Async{name}")
    assert calls(sync) - {"close"} == calls(of_loop) - {"id"}


def test_keys_come_from_the_environment_a_file_or_what_login_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("GRIDPOSE_KEY", "GRIDPOSE_KEY_FILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    url = "http://measuring-pc:8000/"
    assert find_key(url) is None
    save_key(url, "gp_kept")
    assert find_key(url.rstrip("/")) == "gp_kept"
    assert find_key("http://other:8000") is None
    assert (tmp_path / "gridpose" / "credentials.json").stat().st_mode & 0o077 == 0
    (tmp_path / "key").write_text("gp_file\n")
    monkeypatch.setenv("GRIDPOSE_KEY_FILE", str(tmp_path / "key"))
    assert find_key(url) == "gp_file"
    (tmp_path / "key").write_text("two keys")
    with pytest.raises(ClientError, match="key_unreadable"):
        find_key(url)
    monkeypatch.setenv("GRIDPOSE_KEY", "gp_environment")
    assert find_key(url) == "gp_environment"
    assert forget_key(url)
    assert saved_key(url) is None
    assert not forget_key(url)
    (tmp_path / "gridpose" / "credentials.json").write_text("{")
    with pytest.raises(ClientError, match="key_unreadable"):
        saved_key(url)


def test_after_a_login_its_service_is_meant_for_its_own_key_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("GRIDPOSE_KEY", "GRIDPOSE_KEY_FILE", "GRIDPOSE_URL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    here, other = "http://127.0.0.1:8000", "http://measuring-pc:8000"
    assert ReadAccess().url == Gridpose().url == here
    save_key(other + "/", "gp_kept_secret")
    assert ReadAccess().url == UploadAccess().url == Gridpose().url == other
    assert ReadAccess(key="gp_a_b").url == Gridpose(key="gp_a_b").url == here
    assert ReadAccess(url=here).url == Gridpose(here).url == here
    monkeypatch.setenv("GRIDPOSE_KEY", "gp_a_b")
    assert Gridpose().url == here
    monkeypatch.delenv("GRIDPOSE_KEY")
    assert forget_key(other)
    assert ReadAccess().url == here
    (tmp_path / "gridpose" / "credentials.json").write_text("{")
    assert ReadAccess().url == here
