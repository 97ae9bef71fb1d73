"""Rasters for geographic information systems, by way of rasterio (``pip install sightline[raster]``)."""

from __future__ import annotations

import numpy as np

from .types import Viewshed


def write_geotiff(viewshed: Viewshed, path: str) -> None:
    """Writes the cells of a viewshed as a one-band GeoTIFF of bytes: 0 no data, 1 visible, 2 unknown, 3 blocked.

    North is up; a pixel is centred on its post. The reference system is the terrain's, if it has one.
    """
    try:
        import rasterio
        from rasterio.transform import Affine
    except ImportError as error:
        raise ImportError("writing GeoTIFF needs rasterio: pip install sightline[raster]") from error
    terrain, cells = viewshed.terrain, viewshed.cells
    if not cells.size:
        raise ValueError("a viewshed without posts is no raster")
    rows, columns = cells.shape
    west, north = terrain.map_from_grid(viewshed.first_i - 0.5, viewshed.first_j + rows - 0.5)
    transform = Affine(terrain.step[0], 0.0, west, 0.0, -terrain.step[1], north)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=columns,
        height=rows,
        count=1,
        dtype="uint8",
        nodata=0,
        crs=f"EPSG:{terrain.epsg}" if terrain.epsg else None,
        transform=transform,
        compress="deflate",
    ) as raster:
        raster.write(np.flipud(cells).astype(np.uint8), 1)
        raster.update_tags(1, classes="1 visible, 2 unknown, 3 blocked")
