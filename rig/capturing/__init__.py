"""How a capture runs: session, loop, steps, photos, and what interrupts it."""
