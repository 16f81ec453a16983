/** What urdf-loader finds in place of three's mesh readers: the page reads meshes itself (picture/robot_model.js), with readers that come when a robot has such a file. */
export class ColladaLoader {}
export class STLLoader {}
