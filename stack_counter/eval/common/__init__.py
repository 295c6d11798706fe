"""What several evaluations share: cases, metrics, plots."""
