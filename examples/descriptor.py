"""The scene descriptor of a segmentation map of your own, and what can be read back from it.

The map is drawn by hand: a road between two sidewalks, a crosswalk, two people, a parked truck.
Any network's softmax over the same 28 classes would do as well, in any size.
Run it: python examples/descriptor.py
"""

import numpy as np

from vsr.classes import CLASS_COUNT, SemanticClass
from vsr.entities import find_entities
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.decoding import Decoder
from vsr.hypervectors.descriptor import SceneDescriptor

rows, columns = np.indices((120, 160))
classes = np.full((120, 160), SemanticClass.SKY)
classes[rows >= 60] = SemanticClass.SIDEWALK
classes[(rows >= 60) & (abs(columns - 80) < rows - 50)] = SemanticClass.ROAD
classes[(abs(rows - 86) < 4) & (abs(columns - 80) < rows - 50)] = SemanticClass.CROSSWALK
classes[(abs(rows - 72) < 14) & (abs(columns - 118) < 12)] = SemanticClass.TRUCK
for row, column, size in ((70, 70, 14), (75, 20, 18)):
    body = (rows - row) ** 2 / size**2 + (columns - column) ** 2 / (size / 3) ** 2 < 1
    classes[body] = SemanticClass.PEDESTRIAN
sure = 0.9 * (np.arange(CLASS_COUNT)[:, None, None] == classes)
probabilities = (sure + 0.1 / CLASS_COUNT).astype(np.float32)  # sums to one at every pixel

codebook = Codebook(seed=0)
descriptor = SceneDescriptor(codebook)
entities = find_entities(probabilities)
layout = descriptor.layout(entities, probabilities)
weights = [1.0 if name.startswith("pedestrian") else 0.75 for name in layout.names]
(vector,) = descriptor.vsr([layout], [weights])
print(f"{len(entities)} entities: {', '.join(entity.name for entity in entities)}")
print(f"VSR: {tuple(vector.shape)}, root mean square {vector.square().mean().sqrt():.2f}\n")

print("read back from the vector alone:")
for entity in Decoder(codebook).decode(vector, most=10):
    beside = sorted(f"{kind.name.lower()} {side}" for kind, side in entity.neighbours)
    cells = np.count_nonzero(entity.coverage > 0.05 * entity.coverage.max())
    print(f"{entity.kind.name.lower():10} at {entity.cell}, {cells} cells, {', '.join(beside)}")
