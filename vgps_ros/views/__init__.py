"""What people look at: plots, Rerun scenes, progress on the terminal."""
