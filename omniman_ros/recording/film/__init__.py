"""A film of a recorded drive, drawn without a display or a graphics card.

`film_log.py` reads what the film shows; `shots.py` cuts the drive into shots and chooses what each
is called; `scene.py` makes the picture at a time from meshes and lines; `camera.py` and
`rasterizer.py` turn triangles into pixels with numpy alone; `picture.py` puts floor, bodies and
captions together; `encoding.py` writes the file.
"""
