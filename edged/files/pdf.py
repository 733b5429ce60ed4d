"""Write one page of grey shapes and lines of text as PDF, true to scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

POINTS_PER_MM = 72 / 25.4
ARC = 0.5522847498307936
"""Distance of control points over the radius, for four Bézier curves that match a circle to 0.03 %."""
MAX_TEXT = 200


@dataclass(frozen=True, slots=True)
class PageShapes:
    """Shapes filled as one path, in mm from the page's upper left corner.

    grey : 0 black to 1 white.  rectangles : x, y, width, height.  circles : x, y, radius.
    triangles : x, y of three corners.
    """

    grey: float
    rectangles: Sequence[Sequence[float]] = ()
    circles: Sequence[Sequence[float]] = ()
    triangles: Sequence[Sequence[float]] = ()


@dataclass(frozen=True, slots=True)
class Text:
    """A line in Helvetica; x, y : start of the baseline, mm; height : font size, mm."""

    x: float
    y: float
    height: float
    line: str


def one_page(
    size_mm: tuple[float, float], shapes: Sequence[PageShapes], texts: Sequence[Text], title: str
) -> bytes:
    """Content of the PDF file. size_mm : width and height of the page."""
    width, height = size_mm
    # from here on millimetres, y down
    lines = [f"{POINTS_PER_MM:.9f} 0 0 {-POINTS_PER_MM:.9f} 0 {height * POINTS_PER_MM:.6f} cm"]
    for shape in shapes:
        lines.append(f"{shape.grey:g} g")
        lines += [f"{x:.5f} {y:.5f} {w:.5f} {h:.5f} re" for x, y, w, h in shape.rectangles]
        lines += [_circle(x, y, radius) for x, y, radius in shape.circles]
        lines += [
            f"{a:.5f} {b:.5f} m {c:.5f} {d:.5f} l {e:.5f} {f:.5f} l h" for a, b, c, d, e, f in shape.triangles
        ]
        lines.append("f")
    lines.append("0 g")
    for text in texts:
        lines.append(
            f"BT /F1 {text.height:.4f} Tf 1 0 0 -1 {text.x:.4f} {text.y:.4f} Tm ({_escaped(text.line)}) Tj ET"
        )
    content = "\n".join(lines).encode("latin-1", "replace")
    box = f"[0 0 {width * POINTS_PER_MM:.6f} {height * POINTS_PER_MM:.6f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        f"<< /Title ({_escaped(title)}) /Producer (edged) >>".encode("latin-1", "replace"),
    ]
    data, places = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n", []
    for number, content_of in enumerate(objects, 1):
        places.append(len(data))
        data += b"%d 0 obj\n%b\nendobj\n" % (number, content_of)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    count = len(objects) + 1
    return data + (
        b"xref\n0 %d\n0000000000 65535 f \n%b" % (count, table)
        + b"trailer\n<< /Size %d /Root 1 0 R /Info 6 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, len(data))
    )


def _circle(x: float, y: float, r: float) -> str:
    k = ARC * r
    return (
        f"{x + r:.5f} {y:.5f} m "
        f"{x + r:.5f} {y + k:.5f} {x + k:.5f} {y + r:.5f} {x:.5f} {y + r:.5f} c "
        f"{x - k:.5f} {y + r:.5f} {x - r:.5f} {y + k:.5f} {x - r:.5f} {y:.5f} c "
        f"{x - r:.5f} {y - k:.5f} {x - k:.5f} {y - r:.5f} {x:.5f} {y - r:.5f} c "
        f"{x + k:.5f} {y - r:.5f} {x + r:.5f} {y - k:.5f} {x + r:.5f} {y:.5f} c h"
    )


def _escaped(line: str) -> str:
    return "".join("\\" + letter if letter in "()\\" else letter for letter in line[:MAX_TEXT])
