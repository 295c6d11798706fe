# SPDX-License-Identifier: Apache-2.0
"""Commands that fit what says gamma, v and walls on simulated scenes; others import none of it."""
