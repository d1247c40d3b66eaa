import numpy as np

from md_service.engine import LammpsEngine
from md_service.graphene import CrackCut, sheet

BOND = 1.3985e-10  # of airebo at 300 K


def pulled_apart(name, folder):
    """Cracked sheet, pulled along y at its upper and lower margins to 16 % at 300 K."""
    crack = CrackCut(-3e-10)
    position = sheet(34e-10, 34e-10, BOND, crack).position
    margin = np.flatnonzero(np.abs(position[:, 1]) > 12e-10)
    anchor = position[margin]
    engine = LammpsEngine(folder, name, position, temperature=300.0, seed=1, crack=crack, lattice_constant=BOND)
    engine.register_anchors(margin, anchor, np.full(len(margin), 80.0), (anchor[:, 1] > 0).astype(np.int64), 4e-13)
    engine.equilibrate(200)
    engine.measure_reference(8, 10)
    load, reports = [], []
    for i in range(160):
        strain = 1e-3 * i
        answer = engine.advance(10, anchor * [1.0, 1.0 + strain, 1.0], np.zeros_like(anchor))
        load.append(answer.ivc_force[0, 1])
        reports.append(engine.broken_bonds())
    engine.close()
    return load, reports


def test_crack_grows_with_the_sharp_cutoff_and_sticks_with_the_default_one(tmp_path):
    load, reports = pulled_apart("airebo-sharp", tmp_path / "sharp")
    assert reports[0].broken == 0
    assert reports[-1].broken >= 5
    assert reports[-1].tip_x > reports[0].tip_x + 8e-10
    tips = [report.tip_x for report in reports]
    assert max(np.diff(tips)) < 8e-10  # it runs, it does not jump
    # Torn apart, the sheet carries little of what it carried.
    assert abs(np.mean(load[-10:])) < 0.5 * max(load)

    _, sticking = pulled_apart("airebo", tmp_path / "default")
    assert sticking[-1].broken == 0
    assert sticking[-1].sticking > 0
    assert "1.70 A" in sticking[-1].warning
