# SPDX-License-Identifier: Apache-2.0
"""How a concave part is split into convex pieces; `physics.collision` says in what order."""
