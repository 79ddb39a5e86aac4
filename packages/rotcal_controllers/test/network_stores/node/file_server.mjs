// An OPC UA server made of node-opcua-file-transfer: FileType over the files of a folder, twice.
//
// usage: node file_server.mjs SETUP.json
//
// "FileSystem" can create, move and delete, and its move replaces a file; "Fixed" only shows the
// files of SETUP.fixed, as a control does that knows which files there are. SETUP.fault holds how
// many operations of the disk go well before half of one is done and the server is killed, or the
// connections are cut.
import fs from "node:fs";
import path from "node:path";
import readline from "node:readline";
import certificateManager from "node-opcua-certificate-manager";
import fileTransfer from "node-opcua-file-transfer";
import secureChannel from "node-opcua-secure-channel";
import opcua from "node-opcua-server";
import statusCode from "node-opcua-status-code";
import variant from "node-opcua-variant";

// They are CommonJS, whose names Node.js does not find by itself.
const { MessageSecurityMode, SecurityPolicy } = secureChannel;
const { DataType } = variant;
const { StatusCodes } = statusCode;
const setup = JSON.parse(fs.readFileSync(process.argv[2], "utf8"));
const work = path.dirname(process.argv[2]);
fs.mkdirSync(path.join(work, "fixed"), { recursive: true });

let server;

function strikes() {
  if (!fs.existsSync(setup.fault)) return false;
  const [left, kind] = fs.readFileSync(setup.fault, "utf8").split(" ");
  if (left !== "0") {
    fs.writeFileSync(setup.fault, `${left - 1} ${kind}`);
    return false;
  }
  fs.rmSync(setup.fault);
  return kind;
}

function strike(kind) {
  if (kind === "kill") process.kill(process.pid, "SIGKILL");
  for (const endpoint of server.endpoints) endpoint.abruptlyInterruptChannels();
}

const disk = {
  ...fs,
  open(name, flags, done) {
    const kind = strikes();
    fs.open(name, flags, (...result) => (kind ? strike(kind) : done(...result)));
  },
  write(fd, data, offset, length, position, done) {
    const kind = strikes();
    const half = kind ? Math.floor(length / 2) : length;
    fs.write(fd, data, offset, half, position, (...result) => (kind ? strike(kind) : done(...result)));
  },
};

function show(space, folder, root, name) {
  const file = space.addressSpace.findObjectType("FileType").instantiate({
    browseName: name,
    organizedBy: folder,
  });
  fileTransfer.installFileType(file, { filename: path.join(root, name), fileSystem: disk });
  return file;
}

function directory(space, parent, root) {
  const shown = new Map();
  const type = space.addressSpace.findObjectType("FileDirectoryType");
  const folder = type.instantiate({ browseName: { name: "FileSystem", namespaceIndex: 0 }, organizedBy: parent });
  const make = (name) => {
    const file = show(space, folder, root, name);
    shown.set(file.nodeId.toString(), [file, name]);
    return { dataType: DataType.NodeId, value: file.nodeId };
  };
  const forget = (nodeId) => {
    const [file, name] = shown.get(nodeId.toString());
    shown.delete(nodeId.toString());
    space.deleteNode(file);
    return name;
  };
  const bind = (method, work) =>
    method.bindMethod((inputs, _context, done) => {
      const kind = strikes();
      const values = work(...inputs.map((input) => input.value));
      if (kind) strike(kind);
      else done(null, { statusCode: StatusCodes.Good, outputArguments: values });
    });
  bind(folder.createFile, (name) => {
    fs.writeFileSync(path.join(root, name), "", { flag: "wx" });
    return [make(name), { dataType: DataType.UInt32, value: 0 }];
  });
  bind(folder.getMethodByName("Delete"), (nodeId) => {
    fs.rmSync(path.join(root, forget(nodeId)));
    return [];
  });
  bind(folder.moveOrCopy, (nodeId, _target, _copy, name) => {
    for (const [key, [file, old]] of shown) {
      if (old === name) {
        shown.delete(key);
        space.deleteNode(file);
      }
    }
    fs.renameSync(path.join(root, forget(nodeId)), path.join(root, name));
    return [make(name)];
  });
  for (const name of fs.readdirSync(root)) make(name);
}

async function start() {
  const certificates = new certificateManager.OPCUACertificateManager({ rootFolder: path.join(work, "pki") });
  await certificates.initialize();
  for (const name of fs.readdirSync(setup.trusted)) {
    fs.copyFileSync(path.join(setup.trusted, name), path.join(work, "pki", "trusted", "certs", name));
  }
  server = new opcua.OPCUAServer({
    port: setup.port,
    host: "127.0.0.1",
    hostname: "127.0.0.1",
    certificateFile: setup.certificate,
    privateKeyFile: setup.key,
    serverCertificateManager: certificates,
    securityPolicies: [SecurityPolicy.Basic256Sha256],
    securityModes: [MessageSecurityMode.SignAndEncrypt],
    allowAnonymous: false,
    disableDiscovery: true,
    userManager: {
      isValidUser: (user, password) => user === setup.user && password === setup.password,
    },
    serverInfo: { applicationUri: "urn:test:server" },
  });
  await server.initialize();
  const addressSpace = server.engine.addressSpace;
  const space = addressSpace.getOwnNamespace();
  const machine = space.addObject({ browseName: "Machine", organizedBy: addressSpace.rootFolder.objects });
  directory(space, machine, setup.folder);
  const fixed = space.addObject({ browseName: "Fixed", organizedBy: machine });
  for (const name of setup.fixed) {
    fs.appendFileSync(path.join(work, "fixed", name), "");
    show(space, fixed, path.join(work, "fixed"), name);
  }
  await server.start();
  console.log(`ready ${process.pid}`);
}

readline.createInterface({ input: process.stdin }).once("line", start).on("close", () => process.exit(0));
