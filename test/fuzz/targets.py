# SPDX-License-Identifier: Apache-2.0
"""Every reader of strangers' bytes by name: what its files look like, and what reads one.

A finding is whatever is no error of this package in one line: another exception, a hang, memory.
"""

import json
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml
from fuzz import files, recordings
from fuzz.mutations import cut_or_mutated, mutated_document
from kits.own_messages import OWN_MESSAGES

from stack_counter.errors import StackCounterError


@dataclass(frozen=True)
class Target:
    """A reader of files.

    Attributes:
        file: name of the file that is read.
        seeds: gives the bytes of whole files; takes a folder for what it needs.
        use: reads a file.
        document: reads its text where it is a document (YAML, JSON); None: bytes.
    """

    file: str
    seeds: Callable
    use: Callable
    document: Callable | None = None

    def whole_files(self):
        """The bytes of whole files."""
        with tempfile.TemporaryDirectory() as folder:
            return list(self.seeds(Path(folder)))

    def outcome(self, data, folder):
        """What becomes of bytes: `used`, or `refused` by an error of this package in one line.

        Args:
            data: the bytes.
            folder: that the reader may use, the same one every time.

        Raises:
            Exception: a finding.
        """
        path = folder / self.file
        path.write_bytes(data)
        try:
            self.use(path)
        except StackCounterError as error:
            assert "\n" not in str(error), f"more than one line: {error!r}"
            return "refused"
        return "used"

    def change(self, data, chance):
        """The bytes after a change at random."""
        if self.document and chance.random() < 0.7:
            try:
                return mutated_document(data, chance, self.document)
            except Exception:  # bytes that were changed before are no document
                pass
        return cut_or_mutated(data, chance)


def _yaml(seeds, use):
    return Target("a.yaml", seeds, use, yaml.safe_load)


def _message(kind):
    seeds, use = recordings.own_message(kind)
    return Target("a.cdr", lambda _: seeds(), use)


TARGETS = {
    "mcap": Target("a.mcap", lambda _: recordings.mcap_files(), recordings.use_bag),
    "db3": Target("a.db3", lambda _: recordings.bags("bare db3")(), recordings.use_bag),
    "ros1": Target("a.bag", lambda _: recordings.bags("ros1", "ros1 lz4", "ros1 bz2")(),
                   recordings.use_bag),
    "metadata": Target("metadata.yaml", lambda _: recordings.metadata_files(),
                       recordings.use_metadata, yaml.safe_load),
    "camera_messages": Target("a.cdr", lambda _: recordings.camera_messages(),
                              recordings.use_camera_message),
    **{kind.__name__: _message(kind) for kind in OWN_MESSAGES},
    "settings": _yaml(lambda _: [files.config_path("stack_counter.yaml").read_bytes()],
                      files.use_settings),
    "parts": _yaml(files.part_catalogues, files.use_parts),
    "gamma_prior": Target("a.json", files.gamma_priors, files.use_gamma_prior, json.loads),
    "containers": _yaml(files.container_catalogues, files.use_containers),
    "rig": _yaml(lambda _: [files.config_path("rig_example.yaml").read_bytes()], files.use_rig),
    "bridges": _yaml(lambda _: [files.config_path(f"{name}.yaml").read_bytes()
                                for name in ("mqtt", "opcua")], files.use_bridges),
    "image": Target("a.png", files.image_files, files.use_image),
    "prompts": _yaml(lambda _: [files.PROMPTS, b'{"parts": {"boxes": [[1, 2, 3, 4]]}}'],
                     files.use_prompts),
    "transforms": Target("a.json", files.transform_files, files.use_scene, json.loads),
    **{suffix: Target(f"a.{suffix}", files.meshes(f".{suffix}"), files.use_mesh)
       for suffix in ("stl", "obj", "ply", "off")},
    "step": Target("a.step", files.step_files, files.use_mesh),
}


def place_of(error):
    """Where an exception comes from: the innermost line of our package, and the innermost one."""
    lines = traceback.extract_tb(error.__traceback__)
    ours = [line for line in lines if "/stack_counter/" in line.filename] or lines
    where = [f"{Path(line.filename).name}:{line.lineno}" for line in (ours[-1], lines[-1])]
    return f"{type(error).__name__} at {' in '.join(dict.fromkeys(where))}"
