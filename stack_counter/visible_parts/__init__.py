# SPDX-License-Identifier: Apache-2.0
"""The parts that show in a stack's surface, located one by one by a network of our own."""
