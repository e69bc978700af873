"""What a display shows: frames of a sweep, the scan before it, the frame tag."""
