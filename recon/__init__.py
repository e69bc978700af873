"""Turn saved sessions into surfaces: arrays and files in, arrays and files out."""
