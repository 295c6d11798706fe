"""What is learnt of one part: its piles simulated, its template scanned, its bins counted."""
