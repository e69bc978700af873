"""The published experiments, each as one command: simulated, reconstructed by both methods, and set beside the paper's figures."""
