# SPDX-License-Identifier: Apache-2.0
"""The 3D model of a report: a GLB file of surface, container and what may lie below.

Source: glTF 2.0: y is up, vertex colours are linear, the default material is a metal.
"""

from __future__ import annotations

import numpy as np

from stack_counter.types import Mesh

_T_GLTF_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def build_glb(meshes: dict[str, Mesh], hidden: str = "") -> bytes:
    """Returns a GLB file of meshes with colours, by name; world frame but with y up.

    Args:
        meshes: what it shows; each has a material of its name.
        hidden: name of the mesh that does not show until its material is made opaque.
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    scene = trimesh.Scene()
    for name, mesh in meshes.items():
        assert mesh.colors is not None  # for the type checker
        shape = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
        shape.apply_transform(_T_GLTF_WORLD)
        shape.visual = TextureVisuals(material=PBRMaterial(
            name=name, metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True,
            **({"alphaMode": "MASK", "baseColorFactor": (255, 255, 255, 0)} if name == hidden
               else {})))
        shape.visual.vertex_attributes["color"] = linear_colors(mesh.colors)
        scene.add_geometry(shape, node_name=name, geom_name=name)
    return bytes(scene.export(file_type="glb", include_normals=True))


def linear_colors(colors: np.ndarray) -> np.ndarray:
    """Returns (n, 4) uint8 linear RGBA of (n, 3) uint8 sRGB colours.

    Source: IEC 61966-2-1.
    """
    srgb = colors / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    opaque = np.full((len(colors), 1), 255)
    return np.hstack([np.round(255 * linear), opaque]).astype(np.uint8)
