"""Camera messages and transforms become posed views."""
