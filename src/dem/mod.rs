//! Readers of elevation files: SRTM `.hgt`, GeoTIFF and Esri ASCII grids. Files in, rasters out, nothing else.
