# SPDX-License-Identifier: Apache-2.0
"""A small arm as URDF: a turning box, a hand that slides down from it, and a ball as a mesh."""

import numpy as np
import trimesh
from kits.recording_kit import header, make

JOINTS = ("shoulder", "slide")
ARM_HEIGHT, ARM_LENGTH = 0.35, 0.5
URDF = f"""<?xml version="1.0"?>
<robot name="arm">
  <link name="robot_base"><visual><geometry><cylinder radius="0.05" length="0.1"/></geometry>
    <origin xyz="0 0 0.05"/></visual></link>
  <link name="arm"><collision><origin xyz="{ARM_LENGTH / 2} 0 0"/>
    <geometry><box size="{ARM_LENGTH} 0.06 0.04"/></geometry></collision></link>
  <link name="hand"><visual><geometry><mesh filename="MESH" scale="0.001 0.001 0.001"/></geometry>
    </visual></link>
  <link name="tool0"/>
  <joint name="shoulder" type="revolute"><parent link="robot_base"/><child link="arm"/>
    <origin xyz="0 0 {ARM_HEIGHT}"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/>
    <origin xyz="{ARM_LENGTH} 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><parent link="hand"/><child link="tool0"/>
    <origin xyz="0 0 -0.05"/></joint>
</robot>
"""


def write_urdf(folder, mesh="package://arm_description/meshes/ball.stl"):
    """Path of the URDF in a package `arm_description` with its mesh, a ball of 30 mm radius."""
    package = folder / "arm_description"
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True, exist_ok=True)
    trimesh.creation.icosphere(subdivisions=4, radius=30.0).export(
        package / "meshes" / "ball.stl")
    (package / "urdf" / "arm.urdf").write_text(URDF.replace("MESH", mesh))
    return package / "urdf" / "arm.urdf"


def add_arm(scene, T_world_base, turn, slide):
    """Adds the arm, its joints at these positions, to a scene; the base stands upright."""
    yaw = np.arctan2(T_world_base[1, 0], T_world_base[0, 0]) + turn
    along, base = np.array([np.cos(yaw), np.sin(yaw), 0]), T_world_base[:3, 3]
    shoulder = base + [0, 0, ARM_HEIGHT]
    scene.box(shoulder + along * ARM_LENGTH / 2, [ARM_LENGTH, 0.06, 0.04], yaw)
    scene.sphere(shoulder + along * ARM_LENGTH - [0, 0, slide], 0.03)
    return scene.cylinder(base[0], base[1], 0.05, base[2] + 0.1)


def joint_state(stamp_ns, names=JOINTS, positions=(0.0, 0.0)):
    """A `JointState`."""
    return make("sensor_msgs/msg/JointState", header=header(stamp_ns, ""), name=list(names),
                position=np.array(positions, float), velocity=np.zeros(0), effort=np.zeros(0))


def joint_record(stamp_ns, positions, topic="/joint_states"):
    """The same as a record of a bag."""
    return (stamp_ns, topic, "sensor_msgs/msg/JointState",
            joint_state(stamp_ns, positions=positions))
