"""Import of a room that relight exported, and export of the changes of its lights as an edit file."""

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from . import room

bl_info = {
    "name": "relight room",
    "author": "The relight developers",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "File > Import, File > Export",
    "description": "Rooms of relight with their estimated lights; changes of lights as an edit file",
    "category": "Import-Export",
}


class ImportRoom(bpy.types.Operator, ImportHelper):
    """Import a room that `relight export` wrote: camera, surface, lights"""

    bl_idname = "import_scene.relight_room"
    bl_label = "relight room"
    bl_options = {"UNDO"}
    filename_ext = ".usda"
    filter_glob: StringProperty(default="*.usda", options={"HIDDEN"})
    photo: StringProperty(name="Photo", description="Picture that is projected onto the surface; empty for picture.png beside the room", default="")

    def execute(self, context):
        try:
            room.import_room(context, self.filepath, self.photo)
        except room.RoomError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class ExportEdit(bpy.types.Operator, ExportHelper):
    """Write the changes of the lights as an edit file of relight"""

    bl_idname = "export_scene.relight_edit"
    bl_label = "relight edit"
    filename_ext = ".ron"
    filter_glob: StringProperty(default="*.ron", options={"HIDDEN"})

    def execute(self, context):
        try:
            text, warnings = room.edit_text(context.scene)
            with open(self.filepath, "w", encoding="utf-8") as file:
                file.write(text)
        except (room.RoomError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for warning in warnings:
            self.report({"WARNING"}, warning)
        return {"FINISHED"}


def import_entry(self, _context):
    self.layout.operator(ImportRoom.bl_idname, text="relight room (.usda)")


def export_entry(self, _context):
    self.layout.operator(ExportEdit.bl_idname, text="relight edit (.ron)")


def register():
    bpy.utils.register_class(ImportRoom)
    bpy.utils.register_class(ExportEdit)
    bpy.types.TOPBAR_MT_file_import.append(import_entry)
    bpy.types.TOPBAR_MT_file_export.append(export_entry)


def unregister():
    bpy.types.TOPBAR_MT_file_export.remove(export_entry)
    bpy.types.TOPBAR_MT_file_import.remove(import_entry)
    bpy.utils.unregister_class(ExportEdit)
    bpy.utils.unregister_class(ImportRoom)
