"""Views become a `StackVolume`: V, its error, and what the network reads."""
