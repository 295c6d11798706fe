# SPDX-License-Identifier: Apache-2.0
"""Models of `transformers` from a folder that the user names. Nothing is ever downloaded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from stack_counter.errors import WeightsError


def load_pretrained(folder: Path, model_type: str | None, architecture: str, what: str,
                    **settings: Any) -> Any:
    """Loads a model of `transformers`, in evaluation mode.

    Args:
        folder: with `config.json` and safetensors.
        model_type: that `config.json` must name; None: any that the architecture takes.
        architecture: class of `transformers`.
        what: the model's name in messages.
        **settings: of the architecture, beside those in `config.json`.

    Raises:
        WeightsError: folder or safetensors are missing, damaged, of another model or incomplete;
            or `transformers` is not installed.
    """
    folder = Path(folder)
    _check_folder(folder, model_type, what)
    # Load it.
    transformers = _import_transformers(what)
    try:
        model, report = getattr(transformers, architecture).from_pretrained(
            folder, local_files_only=True, use_safetensors=True, output_loading_info=True,
            **settings)
    except Exception as error:  # a library's choice: OSError, ValueError, its own
        raise WeightsError(f"{folder} cannot be loaded as {what}: "
                           f"{str(error).splitlines()[0]}") from error
    # Refuse it where tensors are missing, which the library would initialise at random.
    lacking = sorted(str(k) for k in [*report["missing_keys"], *report["mismatched_keys"]])
    if lacking:
        raise WeightsError(f"{folder} lacks {len(lacking)} tensors, first {lacking[0]}; "
                           f"expected all of {what}")
    return model.eval()


def load_processor(folder: Path, architecture: str, what: str) -> Any:
    """Loads what prepares a model's input, such as a tokenizer, from the model's folder.

    Args:
        folder: of the model.
        architecture: class of `transformers`.
        what: the model's name in messages.

    Raises:
        WeightsError: the folder does not hold it whole, or `transformers` is not installed.
    """
    transformers = _import_transformers(what)
    try:
        return getattr(transformers, architecture).from_pretrained(folder, local_files_only=True)
    except Exception as error:  # a library's choice: OSError, ValueError, its own
        raise WeightsError(f"{folder} holds no {architecture} of {what}: "
                           f"{str(error).strip().splitlines()[0]}") from error


def _import_transformers(what: str) -> Any:
    """The library, which shows no progress of its own.

    Raises:
        WeightsError: it is not installed.
    """
    try:
        import transformers
    except ImportError as error:
        raise WeightsError(f"{what} needs the package transformers, which is not installed; "
                           "expected pip install 'stack_counter[models]'") from error
    transformers.logging.disable_progress_bar()
    return transformers


def model_type_of(folder: Path, what: str) -> str:
    """The type of the model in a folder, as its `config.json` names it.

    Raises:
        WeightsError: there is no such folder or file, or it is not JSON.
    """
    if not folder.is_dir():
        raise WeightsError(f"no folder {folder}; expected one with {what}")
    config = folder / "config.json"
    if not config.is_file():
        raise WeightsError(f"no config.json in {folder}; expected {what}")
    try:
        document = json.loads(config.read_text())
    except ValueError as error:
        raise WeightsError(f"{config} is not JSON: {error}") from error
    return str(document.get("model_type")) if isinstance(document, dict) else "None"


def _check_folder(folder: Path, model_type: str | None, what: str) -> None:
    """Refuses a folder that holds no model of that type."""
    kind = model_type_of(folder, what)
    if model_type is not None and kind != model_type:
        raise WeightsError(f"{folder / 'config.json'} is of model type '{kind}'; expected "
                           f"'{model_type}'")
    if not any(folder.glob("*.safetensors")):
        raise WeightsError(f"no .safetensors in {folder}; expected the weights in that format")
