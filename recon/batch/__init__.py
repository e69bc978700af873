"""Many sessions at a time, on this machine or on a Dask cluster: ``recon batch``."""
