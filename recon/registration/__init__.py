"""What a session says about its own set-up: how the display slipped between air and liquid."""
