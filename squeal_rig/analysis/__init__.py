"""What is computed again from recorded samples."""
