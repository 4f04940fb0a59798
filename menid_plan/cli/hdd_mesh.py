"""`menid hdd mesh`: a part at a quality, and what was checked of it."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.files import replace_file

_ENDINGS = ("obj", "stl", "ply")


@click.command("mesh")
@click.option(
    "--part", type=click.Choice(("board", "bay")), default="board", show_default=True,
    help="Which part.",
)  # fmt: skip
@click.option(
    "--quality", type=float, required=True, metavar="Q",
    help="The share of a scan's vertices that is kept, 0.001 to 0.1.",
)  # fmt: skip
@click.option(
    "--scan", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="A scan of your own (STL, OBJ, PLY; in mm) instead of the designed part.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Where to write it: .obj, .stl or .ply, in mm.",
)  # fmt: skip
@click.option(
    "--report",
    is_flag=True,
    help="Print the checks, those of contact with the other part among them.",
)
@click.pass_context
def command(
    ctx: click.Context,
    part: str,
    quality: float,
    scan: Path | None,
    output: Path | None,
    report: bool,
) -> None:
    """Write a part of the hard drive at a quality, or print what was checked of it.

    Exits with 1 if it is not fit for contact.
    """
    from menid_plan.environments.hdd.extra import require

    kind = output.suffix.lower().removeprefix(".") if output else ""
    if output is None and not report:
        raise click.UsageError("say where to write it (-o), or --report for the checks")
    if output is not None and kind not in _ENDINGS:
        raise click.UsageError(f"{output}: the file's ending must be .obj, .stl or .ply")
    if output is not None and not output.parent.is_dir():
        raise click.UsageError(f"{output}: there is no folder {output.parent}")
    require()
    from menid_plan.environments.hdd.meshes import Source, part_mesh
    from menid_plan.environments.hdd.scans import exported

    found = part_mesh(Source(part, scan), quality)
    if output is not None:
        replace_file(output, exported(found.mesh, kind))
        click.echo(f"wrote {output}", err=True)
    if report:
        from menid_plan.environments.hdd.scene import Physics
        from menid_plan.environments.hdd.validity import validity

        other = {"board": "bay", "bay": "board"}[part]
        pair = {part: found.mesh, other: part_mesh(Source(other), quality).mesh}
        fit = validity(pair["board"], pair["bay"], Physics())
        r = found.report
        click.echo(f"{part} at quality {quality:g}, of a scan with {r.full_vertices} vertices")
        click.echo(f"  vertices        {r.vertices} (asked for: {r.wanted})")
        click.echo(f"  triangles       {r.triangles}")
        click.echo(
            f"  volume          {r.volume:.1f} mm^3 ({100 * (r.volume / r.full_volume - 1):+.2f} %)"
        )
        click.echo(f"  pieces          {r.bodies}")
        click.echo(f"  open edges      {r.open_edges}")
        click.echo(f"  force at rest   {fit.force:.3f} of the weight")
        click.echo(f"  rise            {fit.rise:.3f} of a free one, tilt {fit.tilt:.2f} degrees")
        for fault in fit.faults:
            click.echo(f"  FAULT           {fault}")
        if fit.faults:
            ctx.exit(1)
