"""Simulated piles of parts with their true count, and recordings of them.

    scene = piles.make_scene(seed=1, index=0)       # physics; needs sapien
    truth = truth_of(scene)                          # count, V, gamma
    views = record(scene, views=12, seed=0)          # views with noisy depth and poses
"""
