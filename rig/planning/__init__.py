"""What a capture will do, as data: steps, plan, and the table that shows it."""
