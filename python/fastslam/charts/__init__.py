"""What the figures of a run show, as data; drawn as SVG here, and by Matplotlib in `plots`."""
