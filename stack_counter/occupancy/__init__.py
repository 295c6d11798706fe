"""A `StackVolume` becomes gamma: the network and the baselines."""
