"""Lists of independent jobs, on the processes of this machine or on a cluster."""
