"""What is known of one part, and what that tells about gamma."""
