# SPDX-License-Identifier: Apache-2.0
"""What can qualify a result, with a sentence for people each."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """What qualifies a result: its slug, and one sentence for the person who reads it.

    Messages, files and JSON hold the slug. One that this release does not know (of a newer node)
    is kept under its own name. docs/reasons.md is made of this class.

    Attributes:
        sentence: what was seen, and what to do about it.
        degrades: the count is less than what was asked for, so its status is `degraded`.
    """

    sentence: str
    degrades: bool

    def __new__(cls, slug: str, sentence: str = "", degrades: bool = False) -> Reason:
        """Makes a member whose string value is the slug."""
        reason = str.__new__(cls, slug)
        reason._value_, reason.sentence, reason.degrades = slug, sentence, degrades
        return reason

    @classmethod
    def _missing_(cls, value: object) -> Reason | None:
        if not isinstance(value, str):
            return None
        unknown = str.__new__(cls, value)
        unknown._name_, unknown._value_, unknown.degrades = value.upper(), value, False
        unknown.sentence = f"This release does not know the reason {value}; update it."
        return unknown

    def __format__(self, spec: str) -> str:
        return format(str(self.value), spec)

    NO_DEPTH = (
        "no_depth", "No depth was measured on most of the stack, so V is the hull of its outlines "
        "and mostly too large; record aligned depth images.", True)
    DEPTH_FROM_PICTURES = (
        "depth_from_pictures", "Depth was computed from colour pictures, which measures V less "
        "exactly than a depth camera does; record aligned depth for a narrower interval.")
    LOW_RESOLUTION = (
        "low_resolution", "A part is less than 12 pixels long in the best picture, so its surface "
        "hardly shows; move the camera nearer, or record larger pictures.", True)
    BLURRED_PICTURES = (
        "blurred_pictures", "Hardly anything in the pictures is sharp, so the surface computed "
        "from them is too smooth; hold the camera still, focus it, or expose for a shorter time.",
        True)
    OVEREXPOSED = (
        "overexposed", "Much of the parts is white in the pictures, where no surface shows; "
        "expose for a shorter time, or light the parts from several sides.", True)
    ONE_SIDE = (
        "one_side", "All views look from nearly the same direction, so parts of the surface are "
        "hidden from all of them; move the camera around the stack for a narrower interval.")
    LOW_COVERAGE = (
        "low_coverage", "Much of the container's footprint was seen by no view, and V is a guess "
        "there; add views that look into the container.", True)
    NOTHING_FOUND = (
        "nothing_found", "Neither a container nor parts were found, so the count is 0; if there "
        "are some, check the region of interest, the camera poses and the labels.", True)
    CONTAINER_UNSURE = (
        "container_unsure", "Something like a rim was seen but no container could be fitted, so V "
        "may hold walls and a floor; show the whole rim, or configure or teach the container.",
        True)
    CUT_BY_IMAGE = (
        "cut_by_image", "The heap reaches the border of every image, or some of the container's "
        "rim lies beyond all of them, so some parts may be missing; move the camera back or aim "
        "it at the middle.", True)
    STEEP_HEAP = (
        "steep_heap", "What stands on the support plane or above the container's rim falls off "
        "more steeply than loose parts can, as a container that was not found, an arm or foreign "
        "objects do; configure the container, or clear the place and the view.", True)
    BELOW_FLOOR = (
        "below_floor", "Much of the surface lies below the floor that the container is said to "
        "have; check its configured size, and what it stands on.", True)
    MOSTLY_INFERRED = (
        "mostly_inferred", "Much of V lies where no view saw and was inferred from what lies "
        "around it; add views that look into the container.", True)
    WALL_SHORT = (
        "wall_short", "The container's wall does not show down to what the container is taken to "
        "stand on, or begins anew with a ledge, as on rails, on another container or in a recess; "
        "give container_base_m, or its depth (container_inner_size_m).", True)
    NOISY_DEPTH = (
        "noisy_depth", "The noise of the depth is more than a third of a part's length, so the "
        "surface hardly shows the parts; bring the camera nearer, or use a more exact one.", True)
    SIZE_DISAGREES = (
        "size_disagrees", "The container that was found has another size than the configured "
        "one; check container_inner_size_m, leave it at zeros to have it measured, or give "
        "container_floor_m where the floor is thick.", True)
    VIEWS_APART = (
        "views_apart", "The views' surfaces lie farther apart than noise explains, also after "
        "registering them, so edges are blurred; calibrate the camera on the arm (hand-eye).",
        True)
    CUT_BY_REGION = (
        "cut_by_region", "What stands in the region of interest goes on beyond it and no "
        "container was found, so a part or a wall of it was counted; enlarge or move the region.",
        True)
    CROWDED = (
        "crowded", "Something about as large stands beside what was counted, and was not counted; "
        "set a region of interest around what is meant, or regions around each.", True)
    VIEWS_CONTRADICT = (
        "views_contradict", "Views that contradict the others were left out, so V rests on fewer; "
        "check what moved, and the clocks of images and poses, then scan again.", True)
    VIEWS_LOST = (
        "views_lost", "Views that the collector had sent never reached the reconstructor, so V "
        "rests on fewer; check network and load of the machines, then scan again.", True)
    CAMERA_MISSING = (
        "camera_missing", "At least one camera of the rig gave this scan no view (see "
        "missing_cameras); check its cable, its driver and its topics.", True)
    BAG_TRUNCATED = (
        "bag_truncated", "The recording is cut short and was counted from what is left of it; "
        "record again, and end the recorder before the file is copied.", True)
    FOREIGN_PARTS_OR_WRONG_BIN = (
        "foreign_parts_or_wrong_bin", "The weight on the scale and what the views show differ by "
        "more than three standard deviations, as with foreign parts, another container or a wrong "
        "tare; the count is by vision alone, the interval reaches over both: check the content, "
        "the part and tare_kg.", True)
    NO_WEIGHT = (
        "no_weight", "The scale gave no stable weight in time, so the count is by vision alone; "
        "check weight_topic, what touches the container, and weight_max_age_s.", True)
    WEIGHT_UNUSED = (
        "weight_unused", "The weight was not used, because the catalogue has no piece_weight_g of "
        "the part or several regions share the scale; weigh some pieces and enter their mean.")
    SINGLE_VIEW = (
        "single_view", "gamma was read from one depth image, without walls and floor of the "
        "container; record aligned depth in every view.")
    SHALLOW_STACK = (
        "shallow_stack", "The parts lie scattered rather than piled, which training hardly "
        "covers; the interval is wider, and a fuller container narrows it.")
    FEW_PARTS = (
        "few_parts", "There are fewer parts than in the training piles, so that gamma is hardly "
        "known; the interval is wider, and counting by hand is quick.", True)
    LARGE_PART = (
        "large_part", "The container is only a few part sizes wide, less than in training; check "
        "the part's volume, or count such parts in a wider container.", True)
    UNLIKE_TRAINING = (
        "unlike_training", "The surface is unlike all that the network learnt from, as with a "
        "wrong part volume, ordered packing or foreign objects; check part and container.", True)
    ORDERED_LAYERS = (
        "ordered_layers", "The stack's top is level over two layers or more, as parts lie that "
        "were laid in rows; gamma was learnt on poured parts: the interval is wider, and a "
        "counted bin of such parts helps (stack-counter part calibrate).", True)
    FLAT_FACE = (
        "flat_face", "A flat face takes more of the surface than one of a part can, as that of a "
        "sheet, a lid, a box or an inlay, and what lies below it is taken for parts; take it "
        "away and scan again, or teach the container with what stays in it.", True)
    PART_DISAGREES = (
        "part_disagrees", "The estimator contradicts what is known of this part, as with another "
        "part in the container, ordered packing or foreign objects; check the content.", True)
    FILL_UNLIKE_PILES = (
        "fill_unlike_piles", "The fill is lower or the container narrower than in all piles known "
        "of this part; count one such container and add it (stack-counter part calibrate).")
    PART_UNUSED = (
        "part_unused", "What is known of the part was not used, because another part volume was "
        "given; name the part alone.")
    CONTAINER_UNLIKE_PILES = (
        "container_unlike_piles", "What is known of this part is of open containers seen with "
        "depth, so for a heap, a closed container or pictures its spread is wider; count one such "
        "scan and add it (stack-counter part calibrate).")
    CALIBRATED_ELSEWHERE = (
        "calibrated_elsewhere", "None of the part's counted scans is of this rig; count one "
        "container on it and add it (stack-counter part calibrate).")
    ESTIMATOR_UNHEARD = (
        "estimator_unheard", "The part's piles were read by another estimator, so this one was "
        "not asked; run stack-counter part add again with it.")
