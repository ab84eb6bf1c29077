"""Originals that change on the disk, and files that cannot be deleted."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import httpx2
import numpy as np
import pytest

from app.client import ClientError, ServiceClient
from core.image import decode
from tests.support.image.images import flip_bit
from tests.support.service.service import new_session, wait_until
from tests.support.service.uploads import finished_measurements
from tests.system.faults.images import BOARD, Form, image
from tests.system.faults.injections import undeletable
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = pytest.mark.soak


@pytest.mark.parametrize("form", ["png", "bmp"])
def test_bit_rot_before_the_computation(trial: Trial, data_dir: Path, form: Form) -> None:
    with trial.serving(Supervisor(data_dir, {"GRIDPOSE_WORKERS": "0"})):
        trial.upload(16, form=form).finish()
    rotten = {hashlib.sha256(data).hexdigest(): data for data in (image(n, form) for n in range(8))}
    for sha256, data in rotten.items():
        trial.inject()
        path = original(data_dir, sha256)
        flip_bit(path)
        if form == "bmp":  # silent: without the hash it would be measured, a pixel being wrong
            assert np.count_nonzero(decode(path.read_bytes()) != decode(data)) == 1
    with trial.serving(Supervisor(data_dir)) as service:
        (session_id,) = _sessions(service)
        with trial.client() as client:
            for m in finished_measurements(client, session_id):
                code = m["failure"]["code"] if m["failure"] is not None else None
                assert (code == "original_corrupt") == (m["sha256"] in rotten), m
                if m["sha256"] in rotten:
                    client.put_image(session_id, m["pose_id"], m["sha256"], rotten[m["sha256"]])
        trial.conclude()
        assert service.starts == 1


@pytest.mark.parametrize("form", ["png", "bmp"])
def test_bit_rot_of_measured_originals(trial: Trial, data_dir: Path, form: Form) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        trial.upload(16, form=form).finish()
        (session_id,) = _sessions(service)
        by_hash = {hashlib.sha256(data).hexdigest(): data for data in (image(n, form) for n in range(16))}
        with trial.client() as client:
            rotten = finished_measurements(client, session_id)[:8]
            before = {m["id"]: client.get(f"/v1/measurements/{m['id']}") for m in rotten}
            for m in rotten:
                trial.inject()
                flip_bit(original(data_dir, m["sha256"]))
                with pytest.raises(ClientError) as caught:
                    client.get_bytes(f"/v1/measurements/{m['id']}/image")
                assert caught.value.code == "original_corrupt"
                client.create(f"/v1/measurements/{m['id']}/retry", {})
            finished_measurements(client, session_id)
            for m in rotten:
                found = client.get(f"/v1/measurements/{m['id']}")
                # A result stays until another one replaces it.
                assert found["calibration"] == before[m["id"]]["calibration"]
                assert (found["retry_failure"] or found["failure"])["code"] == "original_corrupt", found
            # The same bytes once more put the original right, and what failed for it is computed again.
            for m in rotten:
                client.put_image(session_id, m["pose_id"], m["sha256"], by_hash[m["sha256"]])
            for m in finished_measurements(client, session_id):
                assert client.get(f"/v1/measurements/{m['id']}")["retry_failure"] is None
        trial.conclude()
        assert service.starts == 1


def test_originals_that_cannot_be_deleted(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        trial.upload(8).finish()
        doomed = [image(number) for number in range(100, 108)]
        with trial.client() as client:
            session_id = new_session(client, BOARD)
            hashes = [hashlib.sha256(data).hexdigest() for data in doomed]
            for sha256, data in zip(hashes, doomed, strict=True):
                client.put_image(session_id, "P1", sha256, data)
            finished_measurements(client, session_id)
        files = [original(data_dir, sha256) for sha256 in hashes]
        try:
            with undeletable(files[:4]):
                trial.inject(4)
                deleted = httpx2.delete(
                    f"{service.url}/v1/sessions/{session_id}",
                    headers={"Authorization": f"Bearer {service.admin_key}"},
                )
                assert deleted.status_code in (204, 503, 507), deleted.text
                assert httpx2.get(f"{service.url}/readyz").status_code == 200
        except subprocess.CalledProcessError as error:
            pytest.skip(f"this disk has no immutable files: {error.stderr!r}")
        service.restart()
        wait_until(
            lambda: not any(file.exists() for file in files), 120, "no file of the deleted session is left"
        )
        trial.conclude()


def original(data_dir: Path, sha256: str) -> Path:
    (path,) = (path for path in (data_dir / "originals").rglob(f"{sha256}*") if path.is_file())
    return path


def _sessions(service: Supervisor) -> list[str]:
    with ServiceClient(service.url, service.admin_key) as client:
        return [session["id"] for session in client.items("/v1/sessions")]
