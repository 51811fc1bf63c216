"""The habits of training loops, each on one colour of the Cornell box: python examples/training_loops.py"""

import kornia
import torch

import torch_radbp as rb

steps = 80
torch.manual_seed(0)
scene = rb.load(rb.asset("cornell_box/scene.xml"), resolution=64)
target = rb.render(scene, spp=512, max_depth=4, seed=10**6)
green = scene.get_parameter("green.reflectance.value").requires_grad_()
truth, found = green.detach().clone(), {}
renderer = rb.Renderer(scene, spp=8, max_depth=4)


def patches(step):
    """A patch per step, at the cost of as many pixels, as stochastic gradient descent would have it."""
    x, y = torch.randint(0, target.shape[3] - 15, (2,)).tolist()
    a, b = (renderer(seed=2 * step + k, window=(x, y, 16, 16)) for k in (0, 1))
    return rb.losses.two_buffer_l2(a, b, target[..., y:y + 16, x:x + 16])


def perceptual(step):
    """A loss of another library; two images have the derivative of each other, so that noise biases it little."""
    pair = rb.losses.exchange_derivatives(renderer(seed=2 * step), renderer(seed=2 * step + 1))
    return sum(kornia.losses.ssim_loss(image, target, 11) for image in pair) / 2


def accumulated(step):
    """Several backward passes to a step: gradients add up as everywhere in torch."""
    for part in range(3):
        ((renderer(seed=4 * step + part) - target).square().mean() / 4).backward()
    return (renderer(seed=4 * step + 3) - target).square().mean() / 4


def with_closure(step):
    """What L-BFGS asks for: the same samples for each of its looks, which it takes for a function without noise."""
    return (renderer(seed=step // 20, seed_grad=10**5 + step // 20) - target).square().mean()


def closure(step, loss_of):
    """The gradient of a step."""
    green.grad = None
    loss = loss_of(step)
    loss.backward()
    return loss


for loss_of in (patches, perceptual, accumulated, with_closure):
    green.data.fill_(0.5)
    lbfgs = loss_of is with_closure
    optimizer = torch.optim.LBFGS([green], max_iter=4) if lbfgs else torch.optim.Adam([green], lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps // 4 if lbfgs else steps):
        optimizer.step(lambda step=step, loss_of=loss_of: closure(step, loss_of))
        schedule.step()
        scene.clamp_()
    found[loss_of.__name__] = rb.render(scene, spp=512, max_depth=4).detach()
    print(f"{loss_of.__name__:12} {[round(value, 3) for value in green.tolist()]}, off by {(green - truth).abs().max():.3f}")
rb.save_image("training_loops.png", rb.contact_sheet({"": torch.cat([target, *found.values()])}, ["target", *found]))
