"""Which pose and cycle a file's path stands for."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app.client import PatternError, plan_files
from app.client.images.files import natural_key, number_cycles


def folder_of(tmp_path: Path, *names: str) -> Path:
    for name in names:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "pose_id", "cycle"),
    [
        ("P1/0003.png", "P1", 3),
        ("P1/DSC04513.JPG", "P1", None),  # a camera's running number is no cycle
        ("P1/front-c7.tif", "P1", 7),
        ("P1/c12.tiff", "P1", 12),
        ("P1/cycle_4.bmp", "P1", 4),
        ("day 1/P2/0001.png", "P2", 1),
        ("P1_0003.png", "P1", 3),
        ("P1-c3.png", "P1", 3),
        ("cell_A_cycle30.jpeg", "cell_A", 30),
        ("left01.jpg", "left01", None),
        ("12.png", "12", None),
    ],
)
def test_usual_layouts(tmp_path: Path, name: str, pose_id: str, cycle: int | None) -> None:
    (image,) = plan_files(folder_of(tmp_path, name)).images
    assert (image.name, image.pose_id, image.cycle) == (name, pose_id, cycle)


@pytest.mark.parametrize(
    ("pattern", "name", "pose_id", "cycle"),
    [
        ("{pose}_{cycle}", "home_up_12.png", "home_up", 12),
        ("{any}/{pose}/{any}-{cycle}", "tuesday/P7/cam0-003.png", "P7", 3),
        ("run{cycle}/{pose}", "run5/P1.jpg", "P1", 5),
        ("{pose}.{any}", "P1.left.png", "P1", None),
    ],
)
def test_patterns(tmp_path: Path, pattern: str, name: str, pose_id: str, cycle: int | None) -> None:
    (image,) = plan_files(folder_of(tmp_path, name), pattern).images
    assert (image.pose_id, image.cycle) == (pose_id, cycle)


def test_one_pose_for_all_needs_no_pose_in_the_pattern(tmp_path: Path) -> None:
    plan = plan_files(folder_of(tmp_path, "a9.png", "b10.png"), "{any}{cycle}", "P1")
    assert [(i.pose_id, i.cycle) for i in plan.images] == [("P1", 9), ("P1", 10)]


@pytest.mark.parametrize(
    ("name", "pose_id", "cycle", "burst"),
    [
        ("P1/c3-b2.png", "P1", 3, 2),
        ("P1/front-c7b1.png", "P1", 7, 1),
        ("P1/0003-b2.png", "P1", 3, 2),
        ("P1/0003.png", "P1", 3, None),
        ("P1_0003_burst2.png", "P1", 3, 2),
        ("P1_0003.png", "P1", 3, None),
        ("board-b2.png", "board-b2", None, None),  # without a cycle, it names no stop
        ("P1/b2.png", "P1", None, None),
    ],
)
def test_several_images_of_a_stop(
    tmp_path: Path, name: str, pose_id: str, cycle: int | None, burst: int | None
) -> None:
    (image,) = plan_files(folder_of(tmp_path, name)).images
    assert (image.pose_id, image.cycle, image.burst) == (pose_id, cycle, burst)


def test_a_pattern_has_the_burst_index_with_the_cycle(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "P1_4_2.png", "P1_4_0.png")
    plan = plan_files(folder, "{pose}_{cycle}_{burst}")
    assert [(i.pose_id, i.cycle, i.burst) for i in plan.images] == [("P1", 4, 2)]
    assert "burst index 0" in plan.skipped[0].reason
    with pytest.raises(PatternError, match="which names the stop"):
        plan_files(folder, "{pose}_{burst}")


@pytest.mark.parametrize("pattern", ["{cycle}", "{pose}{pose}", "{pose}_{joint}"])
def test_unusable_patterns_are_refused(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(PatternError):
        plan_files(tmp_path, pattern)


def test_images_that_cannot_be_tagged_are_listed_with_the_reason(tmp_path: Path) -> None:
    names = ("pose one/0001.png", "P1/0.png", "ok/1.png", "P" * 129 + "/1.png", "P1/4294967296.png")
    plan = plan_files(folder_of(tmp_path, *names))
    assert [(i.name, i.label) for i in plan.images] == [("ok/1.png", None), ("pose one/0001.png", "pose one")]
    assert {s.name for s in plan.skipped} == set(names) - {"ok/1.png", "pose one/0001.png"}
    assert all(s.reason for s in plan.skipped)

    unmatched = plan_files(tmp_path, "{pose}_{cycle}")
    assert not unmatched.images
    assert len(unmatched.skipped) == len(names)


def test_other_and_hidden_files_are_left_and_the_order_is_natural(tmp_path: Path) -> None:
    names = ("P10/1.png", "P2/10.png", "P2/9.png", "notes.txt", ".cache/1.png", "P2/.hidden.png")
    plan = plan_files(folder_of(tmp_path, *names))
    assert [i.name for i in plan.images] == ["P2/9.png", "P2/10.png", "P10/1.png"]
    assert plan.others == 1


def test_links_that_lead_back_are_followed_once_and_said(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "P1/1.png", "P2/1.png")
    for number in range(4):
        (folder / "P1" / f"up{number}").symlink_to(folder, target_is_directory=True)
    (folder / "P2" / "loop").symlink_to(folder / "P2", target_is_directory=True)
    (folder / "nowhere").symlink_to(folder / "nowhere")
    plan = plan_files(folder)
    assert [i.name for i in plan.images] == ["P1/1.png", "P2/1.png"]
    assert {r.name for r in plan.repeated} == {"P2/loop", *(f"P1/up{n}" for n in range(4))}
    assert not plan.skipped


def test_a_folder_is_searched_under_its_own_name_before_that_of_a_link(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "session/raw/1.png", "elsewhere/7.png") / "session"
    (folder / "P1").symlink_to(folder / "raw", target_is_directory=True)
    (folder / "P7").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    (tmp_path / "elsewhere" / "back").symlink_to(tmp_path, target_is_directory=True)
    plan = plan_files(folder)
    # What lies outside is listed by the link's name, and is searched once, too.
    assert [i.name for i in plan.images] == ["P7/7.png", "raw/1.png"]
    assert {r.name for r in plan.repeated} == {"P1", "P7/back/session", "P7/back/elsewhere"}


def test_a_file_is_listed_under_each_of_its_names(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "raw/1.png")
    (folder / "P1").mkdir()
    (folder / "P1" / "2.png").symlink_to(folder / "raw" / "1.png")
    assert [(i.pose_id, i.cycle) for i in plan_files(folder).images] == [("P1", 2), ("raw", 1)]


def test_natural_order_compares_digits_with_letters() -> None:
    assert sorted(["b", "a10", "10", "a9", "9a"], key=natural_key) == ["9a", "10", "a9", "a10", "b"]


def test_names_that_would_become_one_pose_are_kept_apart(tmp_path: Path) -> None:
    plan = plan_files(folder_of(tmp_path, "Größe/1.png", "Groesse/1.png"))
    assert [(i.name, i.pose_id) for i in plan.images] == [("Groesse/1.png", "Groesse")]
    assert "would be the same pose" in plan.skipped[0].reason


def test_images_without_cycles_are_numbered_by_name_or_time(tmp_path: Path) -> None:
    plan = plan_files(folder_of(tmp_path, "P1/a.png", "P1/b.png", "P2/4.png", "P2/c.png"))
    os.utime(tmp_path / "P1" / "a.png", (2e9, 2e9))
    by_name = number_cycles(plan.images)
    assert [(i.name, i.cycle) for i in by_name if i.pose_id == "P1"] == [("P1/a.png", 1), ("P1/b.png", 2)]
    assert [i.cycle for i in by_name if i.pose_id == "P2"] == [4, None], (
        "one has a cycle: the others are no guess"
    )
    by_time = number_cycles(plan.images, by_time=True, after={"P1": 5})
    assert [(i.name, i.cycle) for i in by_time if i.pose_id == "P1"] == [("P1/a.png", 7), ("P1/b.png", 6)]


def test_names_that_count_from_zero_are_refused_with_advice_or_counted_so(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "P1/0.png", "P1/1.png", "P1/c.png")
    (skipped,) = plan_files(folder).skipped
    assert "--first-cycle 0" in skipped.reason
    assert [image.cycle for image in plan_files(folder, first_cycle=0).images] == [1, 2, None]
