"""Plans controls by sampling: predictive sampling and the cross-entropy method."""
