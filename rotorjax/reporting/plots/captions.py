"""How to read the diagrams of rotor dynamics, a caption for each function that draws one."""

CAPTIONS = {
    "orbit": (
        "Orbit: path of the shaft's centre in the plane of two probes, all orders measured, about its mean position; x "
        "points right, y up. Dot: where the phase reference fires. Arrowhead: sense of whirl."
    ),
    "record_orbit": (
        "Orbit of a record: as recorded in its last revolutions (thin) and filtered at 1X; x points right, y up. Dots: "
        "where the phase reference fires. Arrowhead: sense of whirl of 1X."
    ),
    "full_spectrum": (
        "Full spectrum: amplitude of the circular motion in the sense of rotation (forward, +) and against it "
        "(backward, −) at each order."
    ),
    "centreline": (
        "Shaft centreline: mean position (0X) over speed, joined in the order of speed; x points right, y up. Each "
        "measured position is tied to where the model puts it, a cross."
    ),
    "cascade": "Cascade: spectra over frequency, each raised to its speed; dashed: orders.",
    "waterfall": "Waterfall: spectra over frequency, each raised to its time; dashed: orders.",
    "campbell": (
        "Campbell diagram: natural frequencies over speed, dark where there is little damping, red where a mode grows; "
        "where 1X meets one that unbalance excites is a critical speed (dot). Shaded: measured speeds."
    ),
}
"""By the name of the function."""
