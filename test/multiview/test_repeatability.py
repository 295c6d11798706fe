# SPDX-License-Identifier: Apache-2.0
"""A recording of pictures alone has one count: with any number of threads."""

import json
import os
import subprocess
import sys

import pytest
from kits.bags import bag
from kits.textures import closed_container_views

COUNT_WITH_THREADS = ("import sys, cv2; cv2.setNumThreads(int(sys.argv[1]));"
                      "from stack_counter.cli import main; sys.exit(main(sys.argv[2:]))")


@pytest.mark.timeout(600)
def test_pictures_count_the_same_with_any_number_of_threads(tmp_path):
    recording = bag(tmp_path, closed_container_views())
    results = []
    for threads in ("1", "3"):
        out = tmp_path / f"{threads}.json"
        environment = {**os.environ, **{name: threads for name in (
            "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}}
        subprocess.run([sys.executable, "-c", COUNT_WITH_THREADS, threads, "replay",
                        str(recording), "--unit-volume-cm3", "2", "--direct", "--json", str(out)],
                       env=environment, check=True, capture_output=True)
        results.append(json.loads(out.read_text()))
    assert "depth_from_pictures" in results[0]["reasons"]
    for key in ("count", "count_interval", "volume_m3", "volume_std_m3", "gamma", "gamma_std",
                "container", "views", "reasons"):
        assert results[0][key] == results[1][key], key
