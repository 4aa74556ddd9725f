"""The paper's walker, whose first motion is that of a hand-crafted controller."""
