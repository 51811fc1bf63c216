# %% [markdown]
# # Memory: strategies and strides
#
# The derivative of a path needs, at every bounce, the light that arrives there. Tzu-Mao Li's note *Deriving Radiative
# Backpropagation using the Recursive Form of Path Tracing* (2020) writes the path tracer as a recursion and
# differentiates that:
#
#     forward     L_k = E_k + F_k L_(k+1)
#     backward    gradient = sum over k of a_k (dE_k + dF_k L_(k+1)),  a_(k+1) = F_k a_k
#
# Here `E_k` is what bounce k adds (emission, light from lamps), `F_k` by how much it dims what comes from behind it,
# and `a_k` the adjoint. The note's words for where `L_(k+1)` comes from, and ours:
#
# * *computed again* for every bounce, by a path of its own: quadratic. `QuadraticAdjoint()`.
# * **memoized**: walk the path from its end, and each `L_(k+1)` is known when it is needed. That needs the state of the
#   path at every bounce. `MemoizedAdjoint(stride=1)`, the default.
# * every **k-th** state is kept, those between are computed again from the nearest: `stride=k`. `"sqrt"` takes the
#   stride that keeps least, and `"log"` halves the path again and again: log2 N states, each bounce computed log2 N
#   times.

# %%
import time

import matplotlib.pyplot as plt
import torch

import torch_radbp as rb

scene = rb.load(rb.asset("cornell_box/scene.xml"), resolution=96)
white = scene.get_parameter("white.reflectance.value").requires_grad_()
strategies = {
    "stride 1": rb.MemoizedAdjoint(stride=1),
    "stride 8": rb.MemoizedAdjoint(stride=8),
    "sqrt": rb.MemoizedAdjoint(stride="sqrt"),
    "log": rb.MemoizedAdjoint(stride="log"),
    "log, no hits": rb.MemoizedAdjoint(stride="log", keep_hits=False),
    "replay": rb.ReplayAdjoint(),
    "quadratic": rb.QuadraticAdjoint(),
}

# %% [markdown]
# ## One gradient, many prices
#
# Paths of up to 32 bounces, without Russian roulette. The plan says before a call what it is going to need.

# %%
gradients, seconds, megabytes = {}, {}, {}
for name, adjoint in strategies.items():
    renderer = rb.Renderer(scene, spp=4, max_depth=32, rr_depth=100, adjoint=adjoint,
                           share_samples=True)
    megabytes[name] = renderer.memory_plan().peak / 2**20
    times = []
    for _ in range(3):  # the first compiles
        start = time.perf_counter()
        gradients[name], = torch.autograd.grad(renderer(seed=0).square().mean(), white)
        times.append(time.perf_counter() - start)
    seconds[name] = min(times)
    print(f"{name:13} predicted {megabytes[name]:4.0f} MiB  {seconds[name]:5.2f} s  "
          f"gradient {gradients[name].numpy()}")

# %%
plt.scatter(list(megabytes.values()), list(seconds.values()))
for name in strategies:
    plt.annotate(name, (megabytes[name], seconds[name]), xytext=(5, 5),
                 textcoords="offset points")
plt.xlabel("predicted peak, MiB")
plt.ylabel("seconds, forward and backward")
plt.yscale("log")
plt.margins(0.15)
plt.show()

# %% [markdown]
# All gradients are one gradient. *Replay* keeps nothing and divides by `F_k` on the way down, which is why it is wrong
# where a reflectance is exactly zero; it is here to compare with. `keep_hits=False` also gives up the few bytes a
# bounce by which computing it again casts no ray.
#
# ## Or name a budget
#
# `memory_budget` picks how many paths are traced together, and the stride, so that the predicted peak fits.

# %%
for budget in ("4GiB", "100MiB", "20MiB"):
    settings = {"spp": 64, "max_depth": 32, "rr_depth": 100, "memory_budget": budget}
    plan = rb.Renderer(scene, **settings).memory_plan()
    print(f"{budget:7} {plan.chunk} paths at a time, {plan.peak / 2**20:.0f} MiB")
    print(f"        {plan.adjoint}")

# %%
expected = gradients["stride 1"]
differences = [(gradient - expected).abs().max() for gradient in gradients.values()]
worst = (max(differences) / expected.abs().max()).item()
print(f"the gradients agree to {worst:.1e}")
assert expected.abs().max() > 1e-3 and worst < 1e-4
assert megabytes["log"] < megabytes["stride 1"]
