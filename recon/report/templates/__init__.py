"""Templates, style and scripts of the report, as package data."""
