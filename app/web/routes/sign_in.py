"""Sign-in by key, and sign-out."""

from __future__ import annotations

import hmac
import secrets
from urllib.parse import parse_qs

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, RedirectResponse, Response

from app.http import COOKIE, begin_sign_in, csrf_token
from app.logs import Logger
from app.services.keys import find_key
from app.web.pages import came_by_tls, render, set_sign_in
from app.web.service import service_of

log = Logger(__name__)
router = APIRouter(include_in_schema=False, prefix="/ui")
FORM_COOKIE = "gridpose_form"
"""Binds the sign-in form to the browser that loaded it: nobody is signed in with somebody else's key unawares."""
_FORM_BYTES = 16 * 1024


@router.get("/sign-in")
def show_sign_in(request: Request) -> Response:
    """Ask for a key; who is signed in, and everyone where no keys are asked for, is led on."""
    after = local_page(request.query_params.get("next", "/ui/"))
    if service_of(request).installation.settings.auth == "off" or request.state.key is not None:
        return RedirectResponse(after, status_code=303)
    return _form(request, after, ended="ended" in request.query_params)


@router.post("/sign-in")
async def sign_in(request: Request) -> Response:
    """Take a key and give the browser its cookie."""
    fields = await _read_form(request)
    after = local_page(fields.get("next", "/ui/"))
    installation = service_of(request).installation
    if not _is_own_form(request, fields.get("csrf_token", "")):
        return _form(request, after, 403, problem="This form is too old, or another site sent it. Try again.")
    key = await run_in_threadpool(find_key, installation, fields.get("key", "").strip())
    if key is None:
        log.warning("authentication_failed", client=request.scope["state"].get("client"))
        return _form(
            request,
            after,
            401,
            problem="This key is not valid. Check that it is complete, not expired, not revoked.",
        )
    if key.scope == "ingest":
        return _form(
            request,
            after,
            403,
            problem="This key only sends images (scope ingest); the dashboard needs one that reads.",
        )
    response = RedirectResponse(after, status_code=303)
    set_sign_in(request, response, begin_sign_in(installation, key))
    response.delete_cookie(FORM_COOKIE, path="/ui")
    return response


@router.post("/sign-out")
async def sign_out(request: Request) -> Response:
    """Take the browser's cookie away."""
    fields = await _read_form(request)
    signed_in = request.state.sign_in
    if signed_in is not None:
        expected = csrf_token(service_of(request).installation, signed_in.nonce)
        if not hmac.compare_digest(fields.get("csrf_token", "").encode(), expected.encode()):
            return RedirectResponse("/ui/", status_code=303)
    response = RedirectResponse("/ui/sign-in", status_code=303)
    response.delete_cookie(COOKIE, path="/")
    return response


@router.get("/signed-in")
def is_signed_in(request: Request) -> Response:
    """Answer whether the browser is signed in.

    A browser that follows a link from another site sends no cookie at first (SameSite=Strict); the sign-in page asks
    here, from our own site, and goes on by itself.
    """
    return JSONResponse({"signed_in": request.state.key is not None}, headers={"Cache-Control": "no-store"})


def local_page(address: str) -> str:
    """Return the address if it is a page of the dashboard, else the first page: never another site's."""
    is_ours = (
        address.startswith("/ui/") and "\\" not in address and "//" not in address and address.isprintable()
    )
    return address if is_ours and not address.startswith("/ui/sign") else "/ui/"


def _form(
    request: Request, after: str, status: int = 200, *, problem: str = "", ended: bool = False
) -> Response:
    value = request.cookies.get(FORM_COOKIE) or secrets.token_hex(16)
    response = render(
        request,
        "sign_in.html",
        status,
        next=after,
        problem=problem,
        ended=ended,
        token=csrf_token(service_of(request).installation, f"form {value}"),
    )
    response.set_cookie(
        FORM_COOKIE, value, path="/ui", httponly=True, samesite="strict", secure=came_by_tls(request)
    )
    return response


def _is_own_form(request: Request, token: str) -> bool:
    value = request.cookies.get(FORM_COOKIE)
    if not value:
        return False
    expected = csrf_token(service_of(request).installation, f"form {value}")
    return hmac.compare_digest(token.encode(), expected.encode())


async def _read_form(request: Request) -> dict[str, str]:
    """Return the fields of a small form; what is more than small has none."""
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > _FORM_BYTES:
            return {}
    fields = parse_qs(body.decode("utf-8", "replace"), keep_blank_values=True, max_num_fields=20)
    return {name: values[-1] for name, values in fields.items()}
