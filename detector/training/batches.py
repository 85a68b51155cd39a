"""The views of each step, from a generator seeded by (seed, step) alone: whoever asks for a step, and whenever, gets the same."""
from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch

import data
import methods
from augment import View, cut, mosaic, nothing, single
from data import Picture

MOSAIC_SHARE = 0.4


@dataclass(frozen=True)
class Recipe:
    """What decides over the views of a step."""

    seed: int
    batch: int
    window: int
    view: int
    permissive: bool = False
    method: str = methods.DEFAULT

    def sources(self, step: int, simulated: bool) -> list[tuple[str, int]]:
        eighths = methods.METHODS[self.method].rendered_eighths if simulated else 0
        return data.sources_of_step(step, self.batch, eighths, self.permissive)


def draw(pictures: dict[str, list[Picture]], recipe: Recipe, step: int) -> list[View]:
    """COCO comes first: the teacher sees it too."""
    rng = np.random.default_rng((recipe.seed, step))
    views = []
    method = methods.METHODS[recipe.method]
    for source, count in recipe.sources(step, "simulated" in pictures):
        pool = pictures[source]
        for _ in range(count):
            if rng.random() < MOSAIC_SHARE:
                four = [pool[i] for i in rng.integers(0, len(pool), 4)]
                views.append(mosaic(four, recipe.window, recipe.view, rng))
                continue
            p = pool[rng.integers(0, len(pool))]
            how = single
            if source == "coco" or source == "simulated" and method.cut_rendered:
                share = rng.random()
                if share < method.cut_share:
                    how = cut
                elif source == "coco" and share < method.cut_share + method.nothing_share:
                    how = nothing
            views.append(how(p, recipe.window, recipe.view, rng))
    return views


def coco_views(pictures: dict[str, list[Picture]], recipe: Recipe) -> int:
    """How many views of a step are of COCO: the first ones of draw()."""
    return recipe.sources(0, "simulated" in pictures)[0][1]


def to_tensors(views: list[View], taught: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Pictures (8 bit), of the first `taught` the same in their own colours, targets (n x 6) and ignored regions (m x 5) as
    loss.detection_loss takes them."""
    as_planes = lambda of: torch.from_numpy(np.ascontiguousarray(np.stack(of).transpose(0, 3, 1, 2)))  # noqa: E731
    images, plain = as_planes([v.image for v in views]), as_planes([v.plain for v in views[:taught]])
    targets, ignore = [np.zeros((0, 6), np.float32)], [np.zeros((0, 5), np.float32)]
    for i, v in enumerate(views):
        n = len(v.labels)
        centre, extent = (v.boxes[:, :2] + v.boxes[:, 2:]) / 2, v.boxes[:, 2:] - v.boxes[:, :2]
        targets.append(np.concatenate((np.full((n, 1), i), v.labels[:, None], centre, extent), 1))
        ignore.append(np.concatenate((np.full((len(v.ignore), 1), i), v.ignore), 1))
    as_tensor = lambda rows: torch.from_numpy(np.concatenate(rows).astype(np.float32))  # noqa: E731
    return images, plain, as_tensor(targets), as_tensor(ignore)


class Steps(torch.utils.data.Dataset):
    """The tensors of each step, by its number."""

    def __init__(self, pictures: dict[str, list[Picture]], recipe: Recipe, count: int):
        self.pictures, self.recipe, self.count = pictures, recipe, count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, step: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        cv2.setNumThreads(1)
        return to_tensors(draw(self.pictures, self.recipe, step), coco_views(self.pictures, self.recipe))


def steps(pictures: dict[str, list[Picture]], recipe: Recipe, first: int, last: int, workers: int):
    """The tensors of the steps from `first` to before `last`, in order. `workers` processes draw ahead; 0: none."""
    ahead = {"prefetch_factor": 4} if workers else {}
    return torch.utils.data.DataLoader(Steps(pictures, recipe, last), sampler=range(first, last), batch_size=None,
                                       num_workers=workers, **ahead)
