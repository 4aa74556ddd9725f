"""Temporary: helper in charge of views replaces this file."""

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def plot_learning_curve(result, path):
    fig, ax = plt.subplots()
    ax.plot(
        [i["k"] for i in result["iterations"]],
        [i["deterministic_cost"] for i in result["iterations"]],
    )
    fig.savefig(path)
    plt.close(fig)
