"""The library of primitives is the one list of classes: shipped, from a user's folder, or from both."""

import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from toy_primitive import toy_cup_primitive

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import AssetMissing, InvalidOption, UnknownCategory, UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.types import RESTS, CategorySpec, GenericPrimitive, OptionalPart

_THIRTY = (
    *("bicycle", "bottle", "bowl", "box", "bus", "can", "car", "carton", "cup", "cyclist", "flask", "glass", "jar"),
    *("kettle", "motorcycle", "mug", "pan", "pedestrian", "pitcher", "plate", "pot", "spray_bottle", "teapot"),
    *("traffic_cone", "traffic_sign", "truck", "tube", "van", "vase", "wine_glass"),
)


def _ladle(category: str = "ladle", subcategory: str = "") -> GenericPrimitive:
    return replace(toy_cup_primitive(), category=category, subcategory=subcategory, spec=None)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_primitive(_ladle(), tmp_path)
    save_primitive(_ladle(subcategory="deep"), tmp_path)
    return tmp_path


def test_shipped_library_lists_classes_alphabetically_and_their_subcategories_behind_them():
    library = PrimitiveLibrary.shipped()
    assert library.categories == _THIRTY
    assert library.names[1:7] == ("bottle", "bottle.jug", "bottle.spray", "bowl", "box", "box.open")
    assert len(library.names) == 49
    assert [primitive.name for primitive in library.members_of("cup")] == ["cup", "cup.lidded", "cup.stemmed"]
    assert "mug" in library
    assert "boat" not in library


@pytest.mark.parametrize("name", PrimitiveLibrary.shipped().names)
def test_shipped_card_says_all_that_is_known_of_its_class(name: str):
    library = PrimitiveLibrary.shipped()
    content = json.loads((data_dir("gps") / f"{name}.json").read_text(encoding="utf-8"))["spec"]
    spec = library.spec(name)
    assert content.keys() == spec.as_dict().keys()
    assert spec == library.primitive(name).spec
    assert spec.category == name
    assert spec.parent == (name.split(".")[0] if "." in name else None)
    assert set(spec.rests) <= set(RESTS)
    assert sum(spec.rests.values()) == pytest.approx(1.0, abs=1e-9)
    assert min(spec.rest_costs().values()) == 0.0
    assert (spec.cost == 0.0) == (spec.parent is None)
    low, high = spec.size_range_m
    assert all(0.001 < a < b < 20 for a, b in zip(low, high, strict=True))
    assert set(spec.alike) <= set(library.categories) - {name}


def test_what_stands_lies_or_has_a_part_is_said_by_the_card():
    library = PrimitiveLibrary.shipped()
    assert library.spec("bottle").rest_costs() == {"upright": 0.0, "upside_down": 4.0, "lying": 6.0}
    assert library.spec("cup.stemmed").cost == 2.5
    assert set(library.spec("traffic_sign").rests) == {"upright"}
    assert [name for name in library.names if library.spec(name).optional_parts] == ["bottle.jug", "mug"]
    assert library.spec("van").alike == ("car", "truck")
    assert library.spec("jar").names == {"shapenet": ("03593526",)}


def test_open_vessels_and_closed_ones_are_told_apart():
    library = PrimitiveLibrary.shipped()
    hollow = {name for name in library.names if library.spec(name).hollow}
    assert hollow >= {"bowl", "box.open", "cup", "cup.stemmed", "glass", "jar.open", "mug", "pan", "pot", "vase"}
    assert not hollow & {"bottle", "box", "can", "carton", "cup.lidded", "kettle", "teapot", "tube", "car", "bus"}


def test_class_of_a_users_folder_joins_those_that_ship(folder: Path):
    library = PrimitiveLibrary.with_shipped(folder)
    assert library.categories == tuple(sorted((*_THIRTY, "ladle")))
    assert [primitive.name for primitive in library.members_of("ladle")] == ["ladle", "ladle.deep"]
    assert library.spec("ladle.deep").parent == "ladle"
    assert PrimitiveLibrary(folder).categories == ("ladle",)


def test_class_of_a_later_folder_replaces_an_earlier_one_with_its_subcategories(tmp_path: Path):
    save_primitive(_ladle("cup"), tmp_path)
    library = PrimitiveLibrary.with_shipped(tmp_path)
    assert [primitive.name for primitive in library.members_of("cup")] == ["cup"]
    assert len(library.primitive("cup").vertices) == len(toy_cup_primitive().vertices)
    assert library.categories == _THIRTY


def test_subcategory_of_a_later_folder_joins_its_class(tmp_path: Path):
    save_primitive(_ladle("cup", "toy"), tmp_path)
    names = [primitive.name for primitive in PrimitiveLibrary.with_shipped(tmp_path).members_of("cup")]
    assert names == ["cup", "cup.lidded", "cup.stemmed", "cup.toy"]
    with pytest.raises(UnreadableFile, match=r"cup\.toy.*subcategory of a class that no folder holds"):
        PrimitiveLibrary(tmp_path).categories  # noqa: B018


def test_libraries_of_the_same_folders_are_equal_and_read_a_primitive_once(folder: Path):
    one, other = PrimitiveLibrary.with_shipped(folder), PrimitiveLibrary.with_shipped(folder)
    assert one == other
    assert hash(one) == hash(other)
    assert one != PrimitiveLibrary.shipped()
    assert PrimitiveLibrary.with_shipped() is PrimitiveLibrary.shipped()
    assert one.primitive("ladle") is other.primitive("ladle")
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert again.primitive("cup") is PrimitiveLibrary.shipped().primitive("cup")


def test_pickle_does_not_hold_the_place_of_the_package():
    assert str(data_dir("gps").resolve()).encode() not in pickle.dumps(PrimitiveLibrary.shipped())


def test_primitive_that_is_built_again_is_read_again(folder: Path):
    before = PrimitiveLibrary(folder).primitive("ladle")
    save_primitive(replace(before, licence="CC0-1.0"), folder)
    assert PrimitiveLibrary(folder).primitive("ladle").licence == "CC0-1.0"


def test_unknown_class_is_refused_with_those_on_offer():
    library = PrimitiveLibrary.shipped()
    for ask in (library.primitive, library.members_of, library.spec):
        with pytest.raises(UnknownCategory, match=r"spaceship.*bicycle, bottle, bowl"):
            ask("spaceship")


def test_folders_that_hold_no_primitive_are_refused(tmp_path: Path):
    with pytest.raises(UnreadableFile, match="no folder"):
        PrimitiveLibrary(tmp_path / "nowhere")
    with pytest.raises(UnreadableFile, match="no folder"):
        PrimitiveLibrary()
    with pytest.raises(UnreadableFile, match="holds no primitive"):
        PrimitiveLibrary(tmp_path).categories  # noqa: B018


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rests": {"afloat": 1.0}}, "rests of ladle"),
        ({"rests": {"upright": 0.0}}, "rests of ladle"),
        ({"size_range_m": [[0.2, 0.1, 0.1], [0.1, 0.1, 0.1]]}, "size_range_m of ladle"),
        ({"size_range_m": [[0.1, 0.1], [0.1, 0.1]]}, "size_range_m"),
        ({"density_kg_m3": [0, 10]}, "density_kg_m3 of ladle"),
        ({"density_kg_m3": "heavy"}, "malformed"),
        ({"share": 0}, "share of ladle"),
        ({"alike": "cup"}, "alike"),
        ({"names": {"imagenet": ["ladle"]}}, "names of ladle"),
        ({"parent": "dish"}, "parent of ladle"),
        ({"optional_parts": [{"name": "lid", "keep": "sometimes"}]}, "keep of the part 'lid'"),
        ({"optional_parts": [{"part": "lid"}]}, "malformed"),
        ({"colour": "red"}, "colour"),
        ({"category": "a.b.c"}, "category"),
    ],
)
def test_card_with_a_wrong_spec_is_refused_by_its_file_and_field(folder: Path, change: dict, message: str):
    path = folder / "ladle.json"
    card = json.loads(path.read_text(encoding="utf-8"))
    card["spec"] |= change
    path.write_text(json.dumps(card), encoding="utf-8")
    library = PrimitiveLibrary(folder)
    with pytest.raises(UnreadableFile, match=rf"ladle.*{message}"):
        library.spec("ladle")
    with pytest.raises(UnreadableFile, match=rf"ladle.*{message}"):
        library.primitive("ladle")
    assert library.primitive("ladle.deep").subcategory == "deep"


def test_broken_cards_are_refused_by_name(folder: Path):
    (folder / "ladle.json").write_text("{", encoding="utf-8")
    with pytest.raises(UnreadableFile, match=r"ladle\.json is not a card"):
        PrimitiveLibrary(folder).spec("ladle")
    (folder / "ladle.json").write_text("[1]", encoding="utf-8")
    with pytest.raises(UnreadableFile, match=r"ladle\.json holds a list"):
        PrimitiveLibrary(folder).spec("ladle")
    shutil.copy(folder / "ladle.deep.json", folder / "ladle.json")
    with pytest.raises(UnreadableFile, match=r"ladle\.json is the card of 'ladle\.deep'"):
        PrimitiveLibrary(folder).primitive("ladle")
    (folder / "ladle.json").unlink()
    with pytest.raises(AssetMissing, match=r"ladle\.json is missing"):
        PrimitiveLibrary(folder).spec("ladle")


def test_spec_comes_back_from_its_dictionary_and_the_default_fills_what_is_absent():
    spec = PrimitiveLibrary.shipped().spec("mug")
    assert CategorySpec.from_dict(json.loads(json.dumps(spec.as_dict()))) == spec
    assert CategorySpec.from_dict({"category": "teapot"}) == CategorySpec("teapot")
    with pytest.raises(InvalidOption, match="part"):
        OptionalPart("")


def test_class_built_without_a_spec_gets_one_from_its_members():
    spec = _ladle().spec
    assert spec.category == "ladle"
    assert spec.hollow
    assert spec.density_kg_m3 == (900.0, 2400.0)
    assert max(spec.rests, key=lambda way: spec.rests[way]) == "upright"
    assert spec.optional_parts == ()
    (_, _, low), (_, _, high) = spec.size_range_m
    assert 0.05 < low < 0.07
    assert 0.13 < high < 0.15  # heights are drawn from 60 to 140 mm
    with pytest.raises(InvalidOption, match=r"the spec is of 'ladle', the primitive is of 'pot'"):
        replace(_ladle(), category="pot")
