"""An iteration of a policy search in numbers: what is shown, sent and recorded of it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class IterationMetrics:
    """Outcome of iteration k in numbers; a diverged rollout costs inf.

    Attributes:
        k: 1 … K.
        alpha: α_k.
        initial_ddp_cost: cost of the solution of line 1, mean over initial states.
        ddp_cost: cost of the current solution, mean over initial states.
        deterministic_cost: of the policy without noise, mean over initial states.
        deterministic_survival: share of the initial states from which it survives.
        stochastic_cost_mean: mean over the rollouts that did not diverge.
        stochastic_cost_median: over all rollouts.
        stochastic_survival: share of the rollouts that survive.
        noise_std: σ of the policy [N·m], one a control.
        policy_kl: KL(q(u|x) ‖ π_θ(u|x)) along the trajectories before they were adapted to the
            policy, mean over steps [nat]; in the iteration in which vgps chooses among candidates,
            along those of the first one.
        policy_entropy: entropy of π_θ(u|x) [nat].
        q_step_seconds: wall time of trajectory optimisation.
        m_step_seconds: wall time of the rest of the update.
        simulator_steps: that learning has taken so far, finite differences included.
    """

    k: int
    alpha: float
    initial_ddp_cost: float
    ddp_cost: float
    deterministic_cost: float
    deterministic_survival: float
    stochastic_cost_mean: float
    stochastic_cost_median: float
    stochastic_survival: float
    noise_std: tuple[float, ...]
    policy_kl: float
    policy_entropy: float
    q_step_seconds: float
    m_step_seconds: float
    simulator_steps: int
