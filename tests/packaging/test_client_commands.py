"""What the client alone does with its surroundings: the shell, and the system's credential store."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess
from tests.support.environment.shop_floor import ShopFloor

COMPLETE = """
source .bash_completions/gridpose.sh
COMP_WORDS=(gridpose targets create --ki); COMP_CWORD=3
_gridpose_completion gridpose
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_the_shell_completes_commands(environment: Path, tmp_path: Path) -> None:
    pc = ShopFloor(environment, tmp_path, "http://127.0.0.1:1")
    pc.variables |= {"HOME": str(tmp_path), "PATH": f"{environment}{os.pathsep}{os.environ['PATH']}"}
    bash = shutil.which("bash")
    assert bash is not None
    pc.run(bash, "-c", "gridpose --install-completion; exit $?")
    assert ".bash_completions/gridpose.sh" in (tmp_path / ".bashrc").read_text(encoding="utf-8")
    assert pc.run(bash, "-c", COMPLETE).split() == ["--kind"]


CREDENTIAL_STORE = """
import json, os
from pathlib import Path

from keyring.backend import KeyringBackend
from keyring.errors import KeyringLocked, PasswordDeleteError


class Store(KeyringBackend):
    priority = 1
    file = Path(__file__).with_name("store.json")

    def content(self):
        if os.environ.get("STORE_LOCKED"):
            raise KeyringLocked("nobody unlocked it")
        return json.loads(self.file.read_text()) if self.file.exists() else {}

    def get_password(self, service, username):
        return self.content().get(f"{service} {username}")

    def set_password(self, service, username, password):
        self.file.write_text(json.dumps({**self.content(), f"{service} {username}": password}))

    def delete_password(self, service, username):
        content = self.content()
        if f"{service} {username}" not in content:
            raise PasswordDeleteError(username)
        del content[f"{service} {username}"]
        self.file.write_text(json.dumps(content))
"""


@pytest.mark.slow
def test_a_key_is_kept_in_the_credential_store_and_in_a_file_where_that_is_locked(
    environment: Path, service: ServiceProcess, tmp_path: Path
) -> None:
    """The package `keyring` with a store of the test's own, since a build server has no system's."""
    install = ("install", "-q", "--target", str(tmp_path / "packages"), "keyring")
    subprocess.run([sys.executable, "-m", "pip", *install], check=True)
    (tmp_path / "credential_store.py").write_text(CREDENTIAL_STORE, encoding="utf-8")
    pc = ShopFloor(environment, tmp_path, service.url)
    pc.variables |= {
        "PYTHONPATH": os.pathsep.join((str(tmp_path / "packages"), str(tmp_path))),
        "PYTHON_KEYRING_BACKEND": "credential_store.Store",
    }
    login, key = ("gridpose", "login", "--api-key-file", "-"), service.admin_key
    assert key is not None
    assert "credential store" in pc.run(*login, text=key)
    store, file = tmp_path / "store.json", tmp_path / "gridpose" / "credentials.json"
    assert json.loads(store.read_text(encoding="utf-8")) == {f"gridpose {service.url}": key}
    assert json.loads(file.read_text(encoding="utf-8")) == {"address": service.url}
    pc.run("gridpose", "targets", "list")

    assert "is forgotten" in pc.run("gridpose", "logout")
    assert key not in store.read_text(encoding="utf-8")
    assert "not_authenticated" in pc.run("gridpose", "targets", "list", code=1)
    assert "no key was kept" in pc.run("gridpose", "logout")

    pc.variables["STORE_LOCKED"] = "yes"
    assert str(file) in pc.run(*login, text=key)
    assert json.loads(file.read_text(encoding="utf-8"))[service.url] == key
    pc.run("gridpose", "targets", "list")
