"""Bodies and data to look at: videos, strips of frames, and one page of them all.

Stands beside evaluation: it reads dynamics, behaviour policies and data, and nothing reads it but the command line.
"""

from dynagen_bench.pictures.gallery import write_gallery
from dynagen_bench.pictures.strips import write_strip
from dynagen_bench.pictures.video import Video, render_video

__all__ = ["Video", "render_video", "write_gallery", "write_strip"]
