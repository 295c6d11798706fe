# SPDX-License-Identifier: Apache-2.0
"""The scripts of the page, and the policy that lets these run and nothing be fetched."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from pathlib import Path

VIEWER_VERSION = "4.4.0"
VIEWER_SHA256 = "d785423b1d046ea84a9f59ef6cf15f3077603e1bf938b01ced9b0240691884a2"
_FOLDER = Path(__file__).parent


@cache
def viewer_script() -> str:
    """Returns the source of `<model-viewer>`, which shows the model."""
    return (_FOLDER / "model_viewer" / "model-viewer-umd.min.js").read_text(encoding="utf-8")


@cache
def page_script() -> str:
    """Returns the page's own script."""
    return (_FOLDER / "report.js").read_text(encoding="utf-8")


@cache
def page_style() -> str:
    """Returns the page's style sheet."""
    return (_FOLDER / "report.css").read_text(encoding="utf-8")


def security_policy(*scripts: str) -> str:
    """Returns the Content-Security-Policy of a page with these scripts.

    Nothing comes from a network: pictures and the model lie in the page as `data:`, and what a
    page does not name is forbidden. A script that somebody writes into a name does not run.
    """
    sums = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
            for script in scripts]
    sources = " ".join(f"'sha256-{value}'" for value in sums)
    return "; ".join([
        "default-src 'none'", f"script-src {sources} 'wasm-unsafe-eval'",
        "style-src 'unsafe-inline'",
        "img-src data: blob:", "connect-src data:", "base-uri 'none'",
        "form-action 'none'"])

