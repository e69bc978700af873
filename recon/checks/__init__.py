"""What a session itself shows of the assumptions of the method, and what it cannot show."""
