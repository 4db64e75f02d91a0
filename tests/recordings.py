"""Small recordings of box rooms, rendered when they are read, in place of a dataset."""

from pathlib import Path

import numpy as np

from roomlight.conventions import linear_to_srgb8
from roomlight.dataset.loader import Dataset
from roomlight.dataset.recording import Recording
from rooms import BoxRoom, camera_at


class BoxRecordings(Dataset):
    """`count` sequences of 31 small frames in box rooms of several sizes; frames are rendered when they are read."""

    def __init__(self, count, *, height=60):
        self._count, self._height = count, height

    def __len__(self):
        return self._count

    def frames_of(self, _index):
        return 31

    def room_of(self, index):
        return index // 2

    def read(self, index, *, frames):
        room = BoxRoom(size_m=(5.0 + index % 3, 2.6, 4.5), lamp=((0.5, 2.6, 0.3), 0.3))
        poses = [camera_at((0.2 * index % 1, 1.4, 1.2), yaw_degrees=3.0 * number) for number in frames]
        rendered = [room.frame(pose, width=64, height=48) for pose in poses]
        centre = camera_at((0.2 * index % 1, 1.4, 1.2))[:3, 3]
        positions = centre + np.array([[0.0, -0.2, -1.0], [0.4, 0.1, -1.5], [-0.5, -0.5, -1.2]])
        exposure = np.array([1.0 + 0.01 * number for number in frames])
        colour = np.stack([
            linear_to_srgb8(np.clip(frame.image * gain, 0, 1)) for frame, gain in zip(rendered, exposure, strict=True)
        ])  # fmt: skip
        depth_mm = np.stack([np.rint(frame.depth_m * 1000).astype(np.uint16) for frame in rendered])
        return Recording(
            name=f"box-{index}",
            colour=colour,
            depth_mm=depth_mm,
            surface=np.zeros(depth_mm.shape, np.uint8),
            intrinsics=rendered[0].intrinsics,
            camera_to_world=np.stack(poses),
            exposure=exposure,
            timestamp_s=np.array(frames) / 3.0,
            probe_positions=positions,
            probe_panoramas=np.stack([room.panorama(p, height=self._height)[0] for p in positions]),
            facts={"room_type": "box"},
        )


class BoxWalks(BoxRecordings):
    """Walks through boxes, of three frames, as a dataset gives them."""

    folder = Path("boxes")

    def __getitem__(self, number):
        return self.read(number, frames=[0, 8, 16])
