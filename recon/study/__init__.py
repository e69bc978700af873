"""The published experiments, each as one command: simulated, run by both methods, beside the paper's figures."""
