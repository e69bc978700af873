"""One small protocol for each kind of device, and one module for each real device."""
