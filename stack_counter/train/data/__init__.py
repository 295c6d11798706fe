"""Training inputs: rendered, fused and degraded surfaces."""
