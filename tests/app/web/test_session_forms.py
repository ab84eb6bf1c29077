"""Forms of a new session and of a session's changes: what they state, and what is ticked by itself."""

from __future__ import annotations

import re
from typing import Any

from app.web.pages import environment
from app.web.routes.start import Headline
from tests.support.service.signed_in import signed_in


def page(api: Any, address: str, scope: str = "admin") -> str:
    response = api.client.get(f"/ui/sessions/{address}", headers=signed_in(api, scope))
    assert response.status_code == 200, response.text
    return str(response.text)


def values(text: str) -> dict[str, str]:
    """The fields of lens and conditions with what they hold."""
    return dict(re.findall(r'name="((?:lens|conditions)\.\w+)"[^>]* value="([^"]*)"', text))


def ticked(text: str) -> list[str]:
    return re.findall(r'value="(tgt_\w+)" data-type="list" checked', text)


def test_a_change_shows_lens_and_conditions_as_they_are_stated(api: Any) -> None:
    lens = {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}
    conditions = {"temperature_c": 0.0, "load_kg": 3.2, "operator": "<A> & B", "notes": "after <oil>"}
    stated, bare = api.make_session(lens=lens, conditions=conditions), api.make_session()
    assert values(page(api, f"{stated}/change")) == {
        **{"lens.focal_length_mm": "8", "lens.pixel_pitch_um": "3.45"},
        **{"conditions.temperature_c": "0", "conditions.load_kg": "3.2", "conditions.speed_percent": ""},
        **{"conditions.warm_up_min": "", "conditions.operator": "&lt;A&gt; &amp; B"},
        "conditions.notes": "after &lt;oil&gt;",
    }
    assert "<dt>Notes</dt><dd><bdi>after &lt;oil&gt;</bdi>" in page(api, stated)
    empty = values(page(api, f"{bare}/change"))
    assert set(empty.values()) == {""}
    assert values(page(api, "new")) == empty
    for name in ("lens", "conditions"):
        assert f'data-null="{name}"' in page(api, f"{bare}/change")
        assert f'data-null="{name}"' not in page(api, "new")
    assert "3.45 µm" in page(api, stated)


def test_a_target_is_ticked_where_it_is_the_only_one_or_asked_for(api: Any) -> None:
    first = api.make_target(name="first")
    assert ticked(page(api, "new")) == [first]
    second = api.make_target(name="second")
    assert ticked(page(api, "new")) == []
    assert ticked(page(api, f"new?target={first}")) == [first]
    assert ticked(page(api, f"new?target={second}")) == [second]


def test_a_key_that_only_reads_is_shown_no_form_that_it_may_not_send(api: Any) -> None:
    session_id, target_id = api.make_session(), api.make_target()
    for tail in ("change", "upload"):
        for scope, is_shown in (("read", False), ("upload", True)):
            shown = page(api, f"{session_id}/{tail}", scope)
            assert ("Your key only reads" not in shown) is is_shown
            assert ('class="button primary"' in shown or 'class="primary"' in shown) is is_shown
    for scope, is_shown in (("read", False), ("upload", True)):
        shown = page(api, f"../targets/{target_id}", scope)
        assert ("New session with this target" in shown) is is_shown


def test_the_list_of_sessions_has_whole_reasons_and_shortens_names_to_the_eye_alone(api: Any) -> None:
    reason = "Together the images leave the focal length uncertain by 57.5 %; the limit is 2 %."
    shown = environment().get_template("sessions/_headline.html").render(headline=Headline(reason=reason))
    assert f"no figure: {reason}" in shown
    api.make_session(name="N" * 200)
    listed = api.client.get("/ui/", headers=signed_in(api)).text
    assert f'class="clamped" title="{"N" * 200}"' in listed
