# SPDX-License-Identifier: Apache-2.0
"""A vision-language model that is asked how many parts there are.

The paper asked LlamaVision 3.2 11B. Any image-text model that `transformers` loads will do; the
weights are the user's: a local folder with the model and its processor. Nothing is downloaded.
"""

from __future__ import annotations

import re
from pathlib import Path

import torch

from stack_counter.errors import WeightsError
from stack_counter.picture_baselines.picture import Picture
from stack_counter.pretrained import load_pretrained, load_processor

_QUESTION = ("The picture shows a stack of identical parts ({part}), some of them hidden below "
             "others. How many parts are there in the whole stack, the hidden ones included? "
             "Answer with one number.")
_MAX_NEW_TOKENS = 64  # of an answer; chosen
# Digits, in groups of three behind commas or not.
_INTEGER = re.compile(r"\d{1,3}(?:,\d{3})+(?!\d)|\d+")


class VisionLanguage:
    """Asks one question about each picture."""

    def __init__(self, folder: Path):
        """Loads model and processor.

        Raises:
            WeightsError: the folder is missing, damaged or of another model, has no chat template,
                or `transformers` is not installed.
        """
        # On an accelerator where torch finds one: such models are large.
        device = torch.accelerator.current_accelerator(check_available=True) or "cpu"
        self._model = load_pretrained(folder, None, "AutoModelForImageTextToText",
                                      "an image-text model").to(device)
        self._processor = load_processor(folder, "AutoProcessor", "an image-text model")
        if not getattr(self._processor, "chat_template", None):
            raise WeightsError(f"{folder} has no chat template; expected chat_template.jinja")

    def guess(self, picture: Picture) -> list[float]:
        """Gives the first number of the answer; none if there is none."""
        number = first_integer(self.ask(picture))
        return [] if number is None else [float(number)]

    def ask(self, picture: Picture) -> str:
        """The model's answer to the question how many parts there are."""
        question = _QUESTION.format(part=picture.part)
        text = self._processor.apply_chat_template(
            [{"role": "user", "content": [{"type": "image"}, {"type": "text", "text": question}]}],
            add_generation_prompt=True)
        inputs = self._processor(images=[picture.color], text=[text], return_tensors="pt").to(
            self._model.device, self._model.dtype)
        with torch.inference_mode():
            tokens = self._model.generate(**inputs, max_new_tokens=_MAX_NEW_TOKENS,
                                          do_sample=False)
        new = tokens[:, inputs["input_ids"].shape[1]:]
        return str(self._processor.batch_decode(new, skip_special_tokens=True)[0])


def first_integer(answer: str) -> int | None:
    """The first whole number in a text; None if there is none."""
    found = _INTEGER.search(answer)
    return int(found.group().replace(",", "")) if found else None
