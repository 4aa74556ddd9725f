"""Policy search methods: one file each, one shape for all."""
