"""The hard-drive scenes: a board is levered, shaken or sucked out of its bay, in PyBullet.

From the shapes to the symbols: `geometry` and `scans` make the parts, `meshes` reduces them to a
quality (kept by `cache`), `cells` makes bodies of them that PyBullet can bring into contact, `engine`
is all that is said to PyBullet, `scene` puts board and bay into a world, `lever`, `shake`, `suck` and
`robot` act in it, `symbols` reads the atoms off it, and `kind` offers it all as environments.
"""
