# SPDX-License-Identifier: Apache-2.0
"""Long work: tasks in processes or on a cluster, and how far they are."""
