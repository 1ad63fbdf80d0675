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


def _bowl(category: str = "bowl", subcategory: str = "") -> GenericPrimitive:
    return replace(toy_cup_primitive(), category=category, subcategory=subcategory, spec=None)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_primitive(_bowl(), tmp_path)
    save_primitive(_bowl(subcategory="deep"), tmp_path)
    return tmp_path


def test_shipped_library_lists_classes_alphabetically_and_their_subcategories_behind_them():
    library = PrimitiveLibrary.shipped()
    assert library.categories == ("bottle", "cup", "mug")
    assert library.names == ("bottle", "bottle.jug", "bottle.spray", "cup", "cup.lidded", "cup.stemmed", "mug")
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
    assert set(spec.rests) == set(RESTS)
    assert sum(spec.rests.values()) == pytest.approx(1.0, abs=1e-9)
    assert spec.rest_costs() == {"upright": 0.0, "upside_down": 4.0, "lying": 6.0}
    assert spec.cost == (2.5 if spec.parent else 0.0)
    low, high = spec.size_range_m
    assert all(0.01 < a < b < 0.4 for a, b in zip(low, high, strict=True))
    assert [part.name for part in spec.optional_parts] == (["handle"] if name in ("mug", "bottle.jug") else [])
    assert set(spec.alike) <= set(library.categories)
    assert name in spec.names.get("modelnet", ()) or name in ("mug", *(n for n in library.names if "." in n))


def test_open_vessels_and_closed_ones_are_told_apart():
    library = PrimitiveLibrary.shipped()
    assert [name for name in library.names if library.spec(name).hollow] == ["cup", "cup.stemmed", "mug"]


def test_cups_and_mugs_are_alike_and_bottles_are_like_nothing():
    library = PrimitiveLibrary.shipped()
    assert {name: library.spec(name).alike for name in library.categories} == {
        "bottle": (),
        "cup": ("mug",),
        "mug": ("cup",),
    }


def test_class_of_a_users_folder_joins_those_that_ship(folder: Path):
    library = PrimitiveLibrary.with_shipped(folder)
    assert library.categories == ("bottle", "bowl", "cup", "mug")
    assert [primitive.name for primitive in library.members_of("bowl")] == ["bowl", "bowl.deep"]
    assert library.spec("bowl.deep").parent == "bowl"
    assert PrimitiveLibrary(folder).categories == ("bowl",)


def test_class_of_a_later_folder_replaces_an_earlier_one_with_its_subcategories(tmp_path: Path):
    save_primitive(_bowl("cup"), tmp_path)
    library = PrimitiveLibrary.with_shipped(tmp_path)
    assert [primitive.name for primitive in library.members_of("cup")] == ["cup"]
    assert len(library.primitive("cup").vertices) == len(toy_cup_primitive().vertices)
    assert library.categories == ("bottle", "cup", "mug")


def test_subcategory_of_a_later_folder_joins_its_class(tmp_path: Path):
    save_primitive(_bowl("cup", "toy"), tmp_path)
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
    assert one.primitive("bowl") is other.primitive("bowl")
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert again.primitive("cup") is PrimitiveLibrary.shipped().primitive("cup")


def test_pickle_does_not_hold_the_place_of_the_package():
    assert str(data_dir("gps").resolve()).encode() not in pickle.dumps(PrimitiveLibrary.shipped())


def test_primitive_that_is_built_again_is_read_again(folder: Path):
    before = PrimitiveLibrary(folder).primitive("bowl")
    save_primitive(replace(before, licence="CC0-1.0"), folder)
    assert PrimitiveLibrary(folder).primitive("bowl").licence == "CC0-1.0"


def test_unknown_class_is_refused_with_those_on_offer():
    library = PrimitiveLibrary.shipped()
    for ask in (library.primitive, library.members_of, library.spec):
        with pytest.raises(UnknownCategory, match=r"spaceship.*bottle, cup, mug"):
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
        ({"rests": {"afloat": 1.0}}, "rests of bowl"),
        ({"rests": {"upright": 0.0}}, "rests of bowl"),
        ({"size_range_m": [[0.2, 0.1, 0.1], [0.1, 0.1, 0.1]]}, "size_range_m of bowl"),
        ({"size_range_m": [[0.1, 0.1], [0.1, 0.1]]}, "size_range_m"),
        ({"density_kg_m3": [0, 10]}, "density_kg_m3 of bowl"),
        ({"density_kg_m3": "heavy"}, "malformed"),
        ({"share": 0}, "share of bowl"),
        ({"alike": "cup"}, "alike"),
        ({"names": {"imagenet": ["bowl"]}}, "names of bowl"),
        ({"parent": "dish"}, "parent of bowl"),
        ({"optional_parts": [{"name": "lid", "keep": "sometimes"}]}, "keep of the part 'lid'"),
        ({"optional_parts": [{"part": "lid"}]}, "malformed"),
        ({"colour": "red"}, "colour"),
        ({"category": "a.b.c"}, "category"),
    ],
)
def test_card_with_a_wrong_spec_is_refused_by_its_file_and_field(folder: Path, change: dict, message: str):
    path = folder / "bowl.json"
    card = json.loads(path.read_text(encoding="utf-8"))
    card["spec"] |= change
    path.write_text(json.dumps(card), encoding="utf-8")
    library = PrimitiveLibrary(folder)
    with pytest.raises(UnreadableFile, match=rf"bowl.*{message}"):
        library.spec("bowl")
    with pytest.raises(UnreadableFile, match=rf"bowl.*{message}"):
        library.primitive("bowl")
    assert library.primitive("bowl.deep").subcategory == "deep"


def test_broken_cards_are_refused_by_name(folder: Path):
    (folder / "bowl.json").write_text("{", encoding="utf-8")
    with pytest.raises(UnreadableFile, match=r"bowl\.json is not a card"):
        PrimitiveLibrary(folder).spec("bowl")
    (folder / "bowl.json").write_text("[1]", encoding="utf-8")
    with pytest.raises(UnreadableFile, match=r"bowl\.json holds a list"):
        PrimitiveLibrary(folder).spec("bowl")
    shutil.copy(folder / "bowl.deep.json", folder / "bowl.json")
    with pytest.raises(UnreadableFile, match=r"bowl\.json is the card of 'bowl\.deep'"):
        PrimitiveLibrary(folder).primitive("bowl")
    (folder / "bowl.json").unlink()
    with pytest.raises(AssetMissing, match=r"bowl\.json is missing"):
        PrimitiveLibrary(folder).spec("bowl")


def test_spec_comes_back_from_its_dictionary_and_the_default_fills_what_is_absent():
    spec = PrimitiveLibrary.shipped().spec("mug")
    assert CategorySpec.from_dict(json.loads(json.dumps(spec.as_dict()))) == spec
    assert CategorySpec.from_dict({"category": "teapot"}) == CategorySpec("teapot")
    with pytest.raises(InvalidOption, match="part"):
        OptionalPart("")


def test_class_built_without_a_spec_gets_one_from_its_members():
    spec = _bowl().spec
    assert spec.category == "bowl"
    assert spec.hollow
    assert spec.density_kg_m3 == (900.0, 2400.0)
    assert max(spec.rests, key=lambda way: spec.rests[way]) == "upright"
    assert spec.optional_parts == ()
    (_, _, low), (_, _, high) = spec.size_range_m
    assert 0.05 < low < 0.07
    assert 0.13 < high < 0.15  # heights are drawn from 60 to 140 mm
    with pytest.raises(InvalidOption, match=r"the spec is of 'bowl', the primitive is of 'pot'"):
        replace(_bowl(), category="pot")
