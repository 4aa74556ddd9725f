"""Programs that read runs and bags back."""
